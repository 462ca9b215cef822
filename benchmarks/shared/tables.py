"""Tables in markdown, printed row by row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def header(*names: str) -> None:
    print(f"| {' | '.join(names)} |\n{'|---' * len(names)}|", flush=True)


def row(*cells: object) -> None:
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def table(title: str, names: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    print(f"\n{title}\n")
    header(*names)
    for cells in rows:
        row(*cells)
