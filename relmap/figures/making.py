"""Run figures and write what comes out: pictures, data, verdicts and one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from relmap.core.errors import RelmapError
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, unwatched
from relmap.figures.figure17 import victoria_park
from relmap.figures.page import Entry, page
from relmap.figures.registry import NEEDS_DATA
from relmap.files import atomic_write
from relmap.plots.sheet import write_png

PAGE = "index.html"
VERDICTS = "verdicts.csv"
NO_DATA = "needs the Victoria Park data: give their folder with --data PATH"


@dataclass(frozen=True, eq=False)
class Made:
    """A figure with what came out, or None where it was skipped for the reason in `note`."""

    figure: PaperFigure
    outcome: Outcome | None
    note: str = ""


def stem(figure: PaperFigure) -> str:
    """Return how the names of a figure's files begin."""
    return f"figure{int(figure.name):02d}" if figure.name.isdigit() else figure.name


def check_data(figures: Sequence[PaperFigure], data: Path | None) -> None:
    """Make sure that something can be run before anything is.

    Raises
    ------
    RelmapError
        Where the data are not there or damaged, or nothing can be run without them.
    """
    names = [figure.name for figure in figures]
    if data is not None and NEEDS_DATA in names:
        victoria_park(data)
    elif names == [NEEDS_DATA]:
        raise RelmapError(f"figure {NEEDS_DATA} {NO_DATA}")


def make_figure(
    figure: PaperFigure, folder: Path, quick: bool, data: Path | None, watch: Watch = unwatched
) -> Made:
    """Run a figure and write its picture and its data.

    Raises
    ------
    RelmapError
        Where the data cannot be used or a file cannot be written.
    """
    if data is None and figure.name == NEEDS_DATA:
        return Made(figure, None, NO_DATA)
    outcome = figure.run(quick, data, watch)
    write_png(folder / f"{stem(figure)}.png", outcome.draw)
    outcome.table.write(folder / f"{stem(figure)}.csv")
    for ending, write in outcome.more.items():
        write(folder / f"{stem(figure)}{ending}")
    return Made(figure, outcome)


def write_page(folder: Path, made: Sequence[Made], quick: bool) -> None:
    """Write the page and the table of verdicts on figures that `make_figure` wrote to a folder.

    Raises
    ------
    RelmapError
        Where a file cannot be written.
    """
    done = [(each.figure, each.outcome) for each in made if each.outcome is not None]
    rows = [(figure.name, found.value, found.verdict) for figure, found in done]
    Table(("figure", "value", "verdict"), rows).write(folder / VERDICTS)
    entries = []
    for each in made:
        name = stem(each.figure)
        files = sorted(path for path in folder.glob(f"{name}*") if path.stem.startswith(name))
        picture = (folder / f"{name}.png").read_bytes() if each.outcome is not None else b""
        entries.append(
            Entry(each.figure, each.outcome, each.note, picture, [path.name for path in files])
        )
    atomic_write(folder / PAGE, page(entries, quick))
