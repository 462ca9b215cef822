"""Common parts of pictures: figures, views in one scale, limits, colours, PNG files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, StrMethodFormatter

from relmap.core.arrays import Floats
from relmap.io.files import atomic_write

P = ParamSpec("P")
BLUE = "#1f4e9e"
ORANGE = "#d9822b"
RED = "#c0392b"
SAND = "#f6cf94"
GREY = "#8a8a8a"
PALE = "#e4e4e4"
INK = "#333333"
WIDTH_IN = 7.5
HEIGHT_IN = 8.0
"""Largest size of all views together, without margins."""
BESIDE_IN, ABOVE_IN, BELOW_IN, NARROWEST_IN = 2.1, 1.1, 0.6, 6.5
LEGEND_ROW_IN = 0.2
"""Height of each row of a legend beyond the first."""
LOW_IN, SHORT = 3.5, 20
"""Height up to which the label of a colour bar is in lines of so many characters."""
NARROWEST = 0.15
"""Minimum width of a view, relative to its length."""
BULK = (0.05, 0.95)
"""Quantiles that bound most of the drawn positions."""
FAR = 1.0
"""Largest distance beyond these bounds at which a position is shown, relative to their extent."""
Limits = tuple[Floats, Floats]
"""Lowest and highest coordinates, metres."""


def blank(width_in: float, height_in: float, dpi: int = 150, layout: Any = "constrained") -> Figure:
    """Return an empty figure with constrained layout."""
    figure = Figure(figsize=(width_in, height_in), dpi=dpi, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def finish(axes: Axes, title: str, x: str, y: str) -> None:
    """Label a panel and its axes, and draw a grid."""
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color=PALE, linewidth=0.5)
    axes.set_axisbelow(True)


def legend_below(figure: Figure, most: int, *panels: Axes) -> tuple[Legend, int]:
    """Add a legend of some panels below all panels of a constrained figure.

    It has as many columns, up to `most`, as the figure is wide enough for. Returns the legend and
    its number of rows.
    """
    shown = [axes.get_legend_handles_labels() for axes in panels]
    named = {label: handle for pair in shown for handle, label in zip(*pair, strict=True)}
    style: dict[str, Any] = {"loc": "outside lower center", "frameon": False, "fontsize": 9}
    for columns in range(most, 0, -1):
        legend = figure.legend(list(named.values()), list(named), ncols=columns, **style)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            break
        legend.remove()
    return legend, -(-len(named) // columns)


def limits_of(places: Floats, way: Floats, rim_m: float = 0.0) -> Limits:
    """Return the limits of a picture, with a margin.

    `places` (n, d), metres: a few outliers far from the others and from the path are ignored; `way`
    (k, d), metres: path, shown entirely where it is not NaN. Returns `low`, `high` (d,), metres.
    """
    way = way[np.isfinite(way).all(axis=1)]
    if len(places):
        bulk = np.quantile(places, BULK, axis=0)
        low, high = np.concatenate([bulk, way]).min(axis=0), np.concatenate([bulk, way]).max(axis=0)
        reach = FAR * float(np.ptp(bulk, axis=0).max())
        near = (places >= low - reach) & (places <= high + reach)
        way = np.concatenate([way, places[near.all(axis=1)]])
    if not len(way):
        return -np.ones(way.shape[1]), np.ones(way.shape[1])
    return way.min(axis=0) - rim_m, way.max(axis=0) + rim_m


def first_of(n_submaps: int) -> str:
    """Return the beginning of a title of the map alone: that it is one of several submaps."""
    return f"the first of {n_submaps} submaps: " if n_submaps > 1 else ""


def note_empty(axes: Axes, message: str = "nothing is mapped") -> None:
    """Write into a panel that it shows no map."""
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 13, "color": RED}
    style["bbox"] = {"facecolor": "white", "edgecolor": "none"}
    axes.text(0.5, 0.5, message, transform=axes.transAxes, zorder=10, **style)


def draw_limits(axes: Axes, limits: Limits) -> None:
    """Set the limits (2,), (2,) of a panel, with equal scale for both axes."""
    low, high = limits
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def write_in_full(axis: Any, digits: Sequence[int] = (1, 2, 5)) -> None:
    """Label the numbers of a logarithmic axis with these leading digits, as 1, 2, 5, 10, ..."""
    axis.set_major_locator(LogLocator(10, digits))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


class Sheet:
    """A figure with one view per pair of axes, all in one scale, with the legend below.

    `places` (n, 3), `way` (k, 3), metres: positions to draw; see `limits_of`. `planar`: whether the
    view from above suffices.

    Attributes: `views`, list of (Axes, list of int): panels, and which coordinates each shows.
    """

    def __init__(self, places: Floats, way: Floats, planar: bool, dpi: int = 150) -> None:
        low, high = limits_of(places, way)
        longest = max(float((high - low).max()), 1e-3)
        half = np.maximum((high - low) / 2 + 0.04 * longest, NARROWEST * longest / 2)
        low, high = (low + high) / 2 - half, (low + high) / 2 + half
        self._outside = int(((places < low) | (places > high)).any(axis=1).sum())
        pairs = [[0, 1]] if planar else [[0, 1], [0, 2]]
        tall_m = [float(high[up] - low[up]) for _, up in pairs]
        wide_m = float(high[0] - low[0])
        scale = min(WIDTH_IN / wide_m, HEIGHT_IN / sum(tall_m))
        width = max(scale * wide_m + BESIDE_IN, NARROWEST_IN)
        self.figure = blank(width, scale * sum(tall_m) + BELOW_IN * len(pairs) + ABOVE_IN, dpi)
        panels = self.figure.subplots(len(pairs), 1, squeeze=False, height_ratios=tall_m)[:, 0]
        self.views = list(zip(panels.tolist(), pairs, strict=True))
        for axes, pair in self.views:
            draw_limits(axes, (low[pair], high[pair]))
            finish(axes, "", "x [m]" if axes is panels[-1] else "", f"{'xyz'[pair[1]]} [m]")

    def add_colours(self, dots: Any, label: str) -> None:
        """Add a colour bar for the colours of dots to the right of the views."""
        beside = [axes for axes, _ in self.views]
        label = label if self.figure.get_figheight() > LOW_IN else fill(label, SHORT)
        bar = self.figure.colorbar(dots, ax=beside, label=label, aspect=40, shrink=0.9)
        if isinstance(dots.norm, LogNorm):
            lowest, highest = dots.get_clim()
            digits = "123456789" if highest < 4 * lowest else "125"
            plain = FuncFormatter(lambda v, _: f"{v:.3g}" if f"{v:e}"[0] in digits else "")
            bar.ax.yaxis.set_major_formatter(plain)
            bar.ax.yaxis.set_minor_formatter(plain)

    def finish(self, title: str) -> Figure:
        """Put the title above the views and the legend below them, and return the figure."""
        axes = self.views[0][0]
        outside = f" ({self._outside} far outside not shown)" if self._outside else ""
        axes.set_title(title + outside, fontsize=11, parse_math=False)
        if axes.get_legend_handles_labels()[1]:
            legend, rows = legend_below(self.figure, 3, axes)
            self.figure.set_figheight(self.figure.get_figheight() + LEGEND_ROW_IN * (rows - 1))
            for handle in legend.legend_handles:
                if isinstance(handle, PathCollection):
                    handle.set_sizes([24.0])
        # With a fixed aspect the layout is right only from the second drawing on.
        self.figure.draw_without_rendering()
        return self.figure


def write_png(path: Path, draw: Callable[P, Figure], *args: P.args, **kwargs: P.kwargs) -> None:
    """Draw a figure into a PNG file, in matplotlib's default style.

    The same drawing gives the same bytes.

    `draw`: returns the figure, given the other arguments. Raises `RelmapError` if the file cannot
    be written.
    """
    with mpl.rc_context():
        mpl.rcdefaults()
        picture = BytesIO()
        draw(*args, **kwargs).savefig(picture, metadata={"Software": None})
    atomic_write(path, picture.getvalue())
