"""What pictures are drawn on: blank figures, views in one scale, limits, colours; the PNG file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Concatenate, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter
from numpy.typing import NDArray

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
"""The views together are at most so large; the figure has margins around them."""
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN, GAP_IN = 0.8, 1.3, 0.5, 1.2, 0.55
NARROWEST = 0.15
"""No view is narrower than this share of its length."""
BULK = (0.05, 0.95)
"""Between these quantiles lie most of the places that are drawn."""
FAR = 1.0
"""How far beyond most of them a place may be and be shown, in units of their extent."""
Limits = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Lowest and highest coordinates, metres."""


def blank(width_in: float, height_in: float, dpi: int = 150, layout: Any = "constrained") -> Figure:
    """Return an empty figure; in this layout its panels keep out of each other's way."""
    figure = Figure(figsize=(width_in, height_in), dpi=dpi, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def finish(axes: Axes, title: str, x: str, y: str) -> None:
    """Name a panel and its axes, and put a grid behind what is drawn."""
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color=PALE, linewidth=0.5)
    axes.set_axisbelow(True)


def legend_below(figure: Figure, ncols: int, *panels: Axes) -> None:
    """Explain below the panels of a constrained figure what these of them show."""
    told = [axes.get_legend_handles_labels() for axes in panels]
    named = {label: handle for shown in told for handle, label in zip(*shown, strict=True)}
    style: dict[str, Any] = {"ncols": ncols, "frameon": False, "fontsize": 9}
    figure.legend(list(named.values()), list(named), loc="outside lower center", **style)


def limits_of(places: NDArray[np.float64], way: NDArray[np.float64], rim_m: float = 0.0) -> Limits:
    """Return the limits (d,), (d,) of what is to be shown, with a rim.

    Parameters
    ----------
    places : (n, d) float64, metres
        A few that lie far from all others and from the way are left out.
    way : (k, d) float64, metres
        Shown as a whole, where it is not NaN.
    rim_m : float
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


def draw_limits(axes: Axes, limits: Limits) -> None:
    """Have a panel of two equal axes show what lies within limits."""
    low, high = limits
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def write_in_full(
    axis: Any, values: NDArray[np.float64], digits: Sequence[int] = (1, 2, 5)
) -> None:
    """Write the numbers of a logarithmic axis, that begin with these digits, as 1, 2, 5, 10, ..."""
    steps = np.outer(10.0 ** np.arange(-6, 9), digits).ravel()
    shown = steps[(steps >= values.min() / 1.7) & (steps <= values.max() * 1.7)]
    axis.set_major_locator(FixedLocator(shown.tolist()))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


class Sheet:
    """A figure with one view per pair of axes, all in one scale, the legend below them.

    Parameters
    ----------
    places, way : (n, 3), (k, 3) float64, metres
        What is to be drawn; see `limits_of`.
    planar : bool
        Whether the view from above is enough.
    """

    def __init__(self, places: NDArray[np.float64], way: NDArray[np.float64], planar: bool) -> None:
        low, high = _padded(limits_of(places, way))
        self._outside = int(((places < low) | (places > high)).any(axis=1).sum())
        x_m, y_m, z_m = (high - low).tolist()
        tall_m = y_m if planar else y_m + z_m
        scale = min(WIDTH_IN / x_m, HEIGHT_IN / tall_m)
        sizes = [y_m * scale] if planar else [y_m * scale, z_m * scale]
        width = max(scale * x_m + LEFT_IN + RIGHT_IN, 6.5)
        height = TOP_IN + sum(sizes) + GAP_IN * (len(sizes) - 1) + BOTTOM_IN
        self.figure = blank(width, height, layout=None)
        left = (width - scale * x_m + LEFT_IN - RIGHT_IN) / 2
        self.views: list[tuple[Axes, list[int]]] = []
        top = height - TOP_IN
        for size, across in zip(sizes, (1, 2), strict=False):
            box = (left / width, (top - size) / height, scale * x_m / width, size / height)
            axes = self.figure.add_axes(box)
            axes.set_xlim(low[0], high[0])
            axes.set_ylim(low[across], high[across])
            axes.set_ylabel(f"{'xyz'[across]} [m]")
            axes.grid(color=PALE, linewidth=0.5)
            axes.set_axisbelow(True)
            self.views.append((axes, [0, across]))
            top -= size + GAP_IN
        axes.set_xlabel("x [m]")
        self._right = (left + scale * x_m + 0.15) / width
        self._width, self._height = width, height

    def add_colours(self, dots: Any, label: str) -> None:
        """Put a colour bar to the right of the view from above."""
        box = self.views[0][0].get_position()
        colours = self.figure.add_axes((self._right, box.y0, 0.15 / self._width, box.height))
        bar = self.figure.colorbar(dots, cax=colours, label=label)
        if isinstance(dots.norm, LogNorm):
            lowest, highest = dots.get_clim()
            digits = "123456789" if highest < 4 * lowest else "125"
            plain = FuncFormatter(lambda v, _: f"{v:.3g}" if f"{v:e}"[0] in digits else "")
            bar.ax.yaxis.set_major_formatter(plain)
            bar.ax.yaxis.set_minor_formatter(plain)

    def finish(self, title: str) -> None:
        """Put the title above the views and the legend below them."""
        axes = self.views[0][0]
        outside = f" ({self._outside} far outside not shown)" if self._outside else ""
        axes.set_title(title + outside, fontsize=11)
        handles, labels = axes.get_legend_handles_labels()
        if handles:
            legend = self.figure.legend(
                handles,
                labels,
                loc="lower center",
                ncols=3 if max(map(len, labels)) < 45 else 2,
                frameon=False,
                fontsize=8,
                bbox_to_anchor=(0.5, 0.1 / self._height),
            )
            for handle in legend.legend_handles:
                if isinstance(handle, PathCollection):
                    handle.set_sizes([24.0])


def write_png(path: Path, draw: Callable[[], Figure]) -> None:
    """Draw a figure into a PNG file, in matplotlib's own style whatever the user's.

    The same drawing gives the same bytes.

    Parameters
    ----------
    path : Path
    draw : callable
        Returns the figure.

    Raises
    ------
    RelmapError
        Where the file cannot be written.
    """
    with mpl.rc_context():
        mpl.rcdefaults()
        picture = BytesIO()
        draw().savefig(picture, metadata={"Software": None})
    atomic_write(path, picture.getvalue())


def to_png(draw: Callable[P, Figure]) -> Callable[Concatenate[Path, P], None]:
    """Return what draws into the PNG file of a path given first; see `write_png`."""

    def write(path: Path, /, *args: P.args, **kwargs: P.kwargs) -> None:
        write_png(path, lambda: draw(*args, **kwargs))

    return write


def _padded(limits: Limits) -> Limits:
    """Return limits with a rim, nowhere too thin."""
    low, high = limits
    longest = max(float((high - low).max()), 1e-3)
    half = np.maximum((high - low) / 2 + 0.04 * longest, NARROWEST * longest / 2)
    middle = (low + high) / 2
    return middle - half, middle + half
