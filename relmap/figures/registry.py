"""Every figure, in the paper's order."""

from __future__ import annotations

from collections.abc import Sequence

from relmap.core.errors import RelmapError
from relmap.figures.base import PaperFigure
from relmap.figures.figure04 import CornerFigure
from relmap.figures.figure05 import BenchFigure
from relmap.figures.figure06 import PartialWallFigure
from relmap.figures.figure07 import NoisyMapFigure
from relmap.figures.figure09_11 import ChartFigure, GroupFigure, SortedChartFigure
from relmap.figures.figure12 import ComparisonsFigure
from relmap.figures.figure13 import EightFigure
from relmap.figures.figure14 import LoopTimeFigure
from relmap.figures.figure15 import DensityTimeFigure
from relmap.figures.figure16 import EkfFigure
from relmap.figures.figure17 import VictoriaParkFigure
from relmap.figures.figure_crossing import CrossingFigure

CROSSING = CrossingFigure()
FIGURES: tuple[PaperFigure, ...] = (
    CornerFigure(),
    BenchFigure(),
    PartialWallFigure(),
    NoisyMapFigure(),
    CROSSING,
    ChartFigure(),
    SortedChartFigure(),
    GroupFigure(),
    ComparisonsFigure(),
    EightFigure(),
    LoopTimeFigure(),
    DensityTimeFigure(),
    EkfFigure(),
    VictoriaParkFigure(),
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
        return [figure for figure in FIGURES if figure is not CROSSING]
    wanted = {name.lstrip("0") for name in names}
    known = [figure.name for figure in FIGURES]
    for name in names:
        if name.lstrip("0") in known:
            continue
        if name.lstrip("0") in ("1", "2", "3", "8"):
            raise RelmapError(
                f"figure {name} of the paper is a sketch without results; "
                "those with results are 4 to 7 and 9 to 17"
            )
        raise RelmapError(f"no figure {name!r}; figures are 4 to 7, 9 to 17, and crossing")
    return [figure for figure in FIGURES if figure.name in wanted]
