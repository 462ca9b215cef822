"""Run figures and write what comes out: pictures, data, verdicts and one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from relmap.core.errors import RelmapError
from relmap.figures.base import Made, PaperFigure, Table, Watch, unwatched
from relmap.figures.figure17 import victoria_park
from relmap.figures.page import page
from relmap.figures.registry import NEEDS_DATA
from relmap.io.files import atomic_write
from relmap.plots.sheet import write_png

PAGE = "index.html"
VERDICTS = "verdicts.csv"
NO_DATA = "needs the Victoria Park data: give their folder with --data PATH"


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
    """Run a figure and write its picture and its data; where the run fails, its note says so.

    Raises
    ------
    RelmapError
        Where a file cannot be written.
    """
    if data is None and figure.name == NEEDS_DATA:
        return Made(figure, None, NO_DATA)
    try:
        outcome = figure.run(quick, data, watch)
    except (RelmapError, RuntimeError, np.linalg.LinAlgError) as error:
        return Made(figure, None, "failed: " + " ".join(str(error).split())[:200])
    picture = folder / f"{figure.stem}.png"
    write_png(picture, outcome.draw)
    outcome.table.write(picture.with_suffix(".csv"))
    for ending, write in outcome.more.items():
        write(folder / f"{figure.stem}{ending}")
    files = sorted(path.name for path in folder.glob(f"{figure.stem}*"))
    return Made(figure, outcome, files=tuple(files), picture=picture.read_bytes())


def write_page(folder: Path, made: Sequence[Made], quick: bool) -> None:
    """Write the page and the table of verdicts on figures that `make_figure` made.

    Raises
    ------
    RelmapError
        Where a file cannot be written.
    """
    done = [(each.figure.name, each.outcome) for each in made if each.outcome is not None]
    rows = [(name, found.value, found.verdict) for name, found in done]
    Table(("figure", "value", "verdict"), rows).write(folder / VERDICTS)
    atomic_write(folder / PAGE, page(made, quick))
