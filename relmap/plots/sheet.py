"""What pictures are drawn on: equal axes from above and from the side, in scale; the PNG file."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relmap.io.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 7.5
HEIGHT_IN = 8.0
"""The views together are at most so large; the figure has margins around them."""
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN, GAP_IN = 0.8, 1.3, 0.5, 1.2, 0.55
NARROWEST = 0.15
"""No view is narrower than this share of its length."""


class Sheet:
    """A figure with one view per pair of axes, all in one scale, the legend below them.

    Parameters
    ----------
    points : (n, 3) float64, metres
        Everything that is to be drawn; the views are as large as it needs.
    planar : bool
        Whether the view from above is enough.
    """

    def __init__(self, points: NDArray[np.float64], planar: bool) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        low, high = _limits(points)
        x_m, y_m, z_m = (high - low).tolist()
        tall_m = y_m if planar else y_m + z_m
        scale = min(WIDTH_IN / x_m, HEIGHT_IN / tall_m)
        sizes = [y_m * scale] if planar else [y_m * scale, z_m * scale]
        width = max(scale * x_m + LEFT_IN + RIGHT_IN, 6.5)
        height = TOP_IN + sum(sizes) + GAP_IN * (len(sizes) - 1) + BOTTOM_IN
        self.figure = Figure(figsize=(width, height), dpi=150)
        FigureCanvasAgg(self.figure)
        left = (width - scale * x_m + LEFT_IN - RIGHT_IN) / 2
        self.views: list[tuple[Axes, list[int]]] = []
        top = height - TOP_IN
        for size, across in zip(sizes, (1, 2), strict=False):
            box = (left / width, (top - size) / height, scale * x_m / width, size / height)
            axes = self.figure.add_axes(box)
            axes.set_xlim(low[0], high[0])
            axes.set_ylim(low[across], high[across])
            axes.set_ylabel(f"{'xyz'[across]} [m]")
            axes.grid(color="#e4e4e4", linewidth=0.5)
            axes.set_axisbelow(True)
            self.views.append((axes, [0, across]))
            top -= size + GAP_IN
        axes.set_xlabel("x [m]")
        self._right = (left + scale * x_m + 0.15) / width
        self._width, self._height = width, height

    def add_colours(self, dots: Any, label: str) -> None:
        """Put a colour bar to the right of the view from above."""
        from matplotlib.colors import LogNorm
        from matplotlib.ticker import FuncFormatter

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
        from matplotlib.collections import PathCollection

        axes = self.views[0][0]
        axes.set_title(title, fontsize=11)
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
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        picture = BytesIO()
        draw().savefig(picture, metadata={"Software": None})
    atomic_write(path, picture.getvalue())


def _limits(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (3,), (3,) of a box around points (n, 3), with a rim, nowhere too thin."""
    if not len(points):
        return -np.ones(3), np.ones(3)
    low, high = points.min(axis=0), points.max(axis=0)
    longest = max(float((high - low).max()), 1e-3)
    half = np.maximum((high - low) / 2 + 0.04 * longest, NARROWEST * longest / 2)
    middle = (low + high) / 2
    return middle - half, middle + half
