"""All figures: run them and write pictures, data, verdicts and one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.errors import RelmapError
from relmap.figures import (
    figure04,
    figure05,
    figure06,
    figure07,
    figure09_11,
    figure12,
    figure13,
    figure14_15,
    figure16,
    figure17,
    figure_crossing,
)
from relmap.figures.base import PaperFigure, Table, Watch
from relmap.figures.page import Made, page
from relmap.io.files import atomic_write
from relmap.plots.sheet import write_png

FIGURES: tuple[PaperFigure[Any], ...] = (
    figure04.FIGURE,
    figure05.FIGURE,
    figure06.FIGURE,
    figure07.FIGURE,
    figure_crossing.FIGURE,
    *figure09_11.FIGURES,
    figure12.FIGURE,
    figure13.FIGURE,
    *figure14_15.FIGURES,
    figure16.FIGURE,
    figure17.FIGURE,
)
"""In the paper's order."""
NEEDS_DATA = "17"
NO_DATA = "needs the Victoria Park data: give their folder with --data PATH"


def chosen_figures(names: Sequence[str]) -> list[PaperFigure[Any]]:
    """Return the figures of these names in the paper's order, each once.

    `names`: if empty, all figures of the paper. Raises `RelmapError` if there is no such figure.
    """
    if not names:
        return [figure for figure in FIGURES if figure.name.isdigit()]
    wanted = {name.lstrip("0"): name for name in names}
    for bare, name in wanted.items():
        if bare in ("1", "2", "3", "8"):
            raise RelmapError(
                f"figure {name} of the paper is a sketch without results; "
                "those with results are 4 to 7 and 9 to 17"
            )
        if bare not in [figure.name for figure in FIGURES]:
            raise RelmapError(f"no figure {name!r}; figures are 4 to 7, 9 to 17, and crossing")
    return [figure for figure in FIGURES if figure.name in wanted]


def check_data(figures: Sequence[PaperFigure[Any]], data: Path | None) -> None:
    """Check, before anything is run, that the real data can be used.

    `figures`: figures to run; `data`: path of the real data. Raises `RelmapError` if the data are
    missing, damaged or not used, or nothing can be run without them.
    """
    names = [figure.name for figure in figures]
    if data is not None:
        if NEEDS_DATA not in names:
            raise RelmapError(f"--data is for figure {NEEDS_DATA}, which is not among those given")
        figure17.victoria_park(data)
    elif names == [NEEDS_DATA]:
        raise RelmapError(f"figure {NEEDS_DATA} {NO_DATA}")


def make_figure(
    figure: PaperFigure[Any], folder: Path, quick: bool, data: Path | None, watch: Watch = iter
) -> Made:
    """Run a figure and write its picture and data; if the run fails, the note gives the reason.

    `folder`: output folder; `quick`, `data`, `watch`: as for `PaperFigure.run`. Raises
    `RelmapError` if a file cannot be written.
    """
    if data is None and figure.name == NEEDS_DATA:
        return Made(figure, None, NO_DATA)
    try:
        found = figure.run(quick, data, watch)
        outcome = figure.judge(found)
    except (RelmapError, RuntimeError, np.linalg.LinAlgError) as error:
        return Made(figure, None, "failed: " + " ".join(str(error).split())[:200])
    picture = folder / f"{figure.stem}.png"
    write_png(picture, lambda: figure.draw(found))
    outcome.table.write(picture.with_suffix(".csv"))
    for ending, write in outcome.more.items():
        write(folder / f"{figure.stem}{ending}")
    files = sorted(path.name for path in folder.glob(f"{figure.stem}*"))
    return Made(figure, outcome, files=tuple(files), picture=picture.read_bytes())


def write_page(folder: Path, made: Sequence[Made], quick: bool) -> None:
    """Write the page, index.html, and the table of verdicts, verdicts.csv.

    `made`: results of `make_figure`; `quick`: whether the runs were small. Raises `RelmapError` if
    a file cannot be written.
    """
    done = [(each.figure.name, each.outcome) for each in made if each.outcome is not None]
    rows = [(name, found.value, found.verdict, found.ours) for name, found in done]
    Table(("figure", "value", "verdict", "finding"), rows).write(folder / "verdicts.csv")
    atomic_write(folder / "index.html", page(made, quick))
