"""What the verbs share to talk to a person: progress and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from threading import Timer
from time import monotonic
from typing import TypeVar

T = TypeVar("T")

INTERRUPTED = 130
"""What the process exits with where Ctrl-C ended it."""
PATIENCE_S = 1.0
"""Work that is done sooner shows no progress."""
STEADY_S = 600.0
"""Time over which the speed is averaged, to tell how long the rest will take."""
WIDEST = 1000
"""Columns of a table at most: it is as wide as it needs to be, whatever the terminal."""


def tracked(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Yield the items; show on stderr how far it is, where that is a terminal and it takes long."""
    began = monotonic()
    source = iter(items)
    done = 0
    for item in source:
        yield item
        done += 1
        if monotonic() - began > PATIENCE_S:
            break
    yield from with_bar(source, total, what, done)


def with_bar(items: Iterable[T], total: int, what: str, done: int = 0) -> Iterator[T]:
    """Yield the items; show on stderr how far it is, where that is a terminal, from the start."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    shown = console.is_terminal
    with Progress(
        console=console, transient=True, disable=not shown, speed_estimate_period=STEADY_S
    ) as progress:
        task = progress.add_task(what, total=total, completed=done)
        for item in items:
            yield item
            progress.advance(task)


@contextmanager
def busy(what: str) -> Iterator[Callable[[str], None]]:
    """Tell on stderr what is being done, where that is a terminal and it takes long.

    Yields
    ------
    callable
        Takes what is being done now.
    """
    from rich.console import Console

    status = Console(stderr=True).status(what)
    timer = Timer(PATIENCE_S, status.start)
    if status.console.is_terminal:
        timer.start()
    try:
        yield status.update
    finally:
        timer.cancel()
        if timer.ident is not None:
            timer.join()
        status.stop()


def print_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on stdout, its first column to the left and the others to the right."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for number, name in enumerate(header):
        table.add_column(name, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False, emoji=False, width=WIDEST)
    console.print(title, soft_wrap=True)
    console.print(table)


def figure(value: float | None, kind: str = "") -> str:
    """Return a figure as a person reads it.

    Parameters
    ----------
    value : float or None
    kind : "count", "share" or "time", optional
        What it is, if no error or ratio.
    """
    if value is None:
        return "-"
    if kind == "count" or (kind == "time" and value >= 100):
        return f"{value:.0f}"
    if kind == "share":
        return f"{100 * value:.0f} %"
    return f"{value:.2g}" if kind == "time" else f"{value:.4f}"
