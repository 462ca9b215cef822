"""What the pictures of the paper's figures share: a blank figure and colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE = "#1f4e9e"
ORANGE = "#d9822b"
RED = "#c0392b"
SAND = "#f6cf94"
GREY = "#8a8a8a"
PALE = "#e4e4e4"


def blank(width_in: float, height_in: float) -> Figure:
    """Return an empty figure whose panels keep out of each other's way."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def finish(axes: Axes, title: str, x: str, y: str) -> None:
    """Name a panel and its axes, and put a grid behind what is drawn."""
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color=PALE, linewidth=0.5)
    axes.set_axisbelow(True)
