"""Every figure, in the paper's order."""

from __future__ import annotations

from collections.abc import Sequence

from relmap.core.errors import RelmapError
from relmap.figures import (
    figure04,
    figure05,
    figure06,
    figure07,
    figure09_11,
    figure12,
    figure13,
    figure14,
    figure15,
    figure16,
    figure17,
    figure_crossing,
)
from relmap.figures.base import PaperFigure

FIGURES: tuple[PaperFigure, ...] = (
    figure04.FIGURE,
    figure05.FIGURE,
    figure06.FIGURE,
    figure07.FIGURE,
    figure_crossing.FIGURE,
    *figure09_11.FIGURES,
    figure12.FIGURE,
    figure13.FIGURE,
    figure14.FIGURE,
    figure15.FIGURE,
    figure16.FIGURE,
    figure17.FIGURE,
)
NEEDS_DATA = "17"


def chosen_figures(names: Sequence[str]) -> list[PaperFigure]:
    """Return the figures of these names in the paper's order, each once.

    Parameters
    ----------
    names : sequence of str
        Where it is empty, all figures of the paper.

    Raises
    ------
    RelmapError
        Where there is no such figure.
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
