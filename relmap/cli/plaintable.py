"""Tables of figures on stdout, as wide as they need to be."""

from __future__ import annotations

from collections.abc import Sequence

import typer


def print_plain(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table on stdout at its own width, the first column to the left."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    typer.echo(title)
    for cells in (header, ["-" * width for width in widths], *rows):
        first, *others = zip(cells, widths, strict=True)
        line = [first[0].ljust(first[1]), *(cell.rjust(width) for cell, width in others)]
        typer.echo("  ".join(line).rstrip())


def shown(heading: str, value: float | None) -> str:
    """Return a figure as a person reads it."""
    if value is None:
        return "-"
    if heading in ("of", "MB"):
        return f"{value:.0f}"
    if heading in ("cover", "path"):
        return f"{100 * value:.0f} %"
    if heading in ("RMSE", "RMSE10", "ATE", "RPE", "pairs", "turn"):
        return f"{value:.4f}"
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}"
