"""How the landmark error of several methods goes over a run, noise by noise (Fig. 16)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from relmap.plots.paper import BLUE, GREY, ORANGE, RED, blank, finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GREEN, VIOLET = "#2e7d32", "#7b4fa3"
COLOURS = (RED, ORANGE, GREY, BLUE, GREEN, VIOLET)


@dataclass(frozen=True, eq=False)
class Curve:
    """The error of one method under one noise.

    Attributes
    ----------
    iteration : (p,) int64
    rmse_m : (s, p) float64
        One row for each seed.
    """

    iteration: NDArray[np.int64]
    rmse_m: NDArray[np.float64]

    @property
    def end_m(self) -> float:
        """Error at the end, median of the seeds, metres."""
        return float(np.median(self.rmse_m[:, -1]))


@dataclass(frozen=True, eq=False)
class ErrorCurves:
    """Curves by noise and method, in the order in which they are drawn."""

    COLUMNS: ClassVar = ("noise", "seed", "method", "iteration", "landmark_rmse_m")

    of: Mapping[str, Mapping[str, Curve]]

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield a line for each point of each curve, as `COLUMNS` name them."""
        for noise, methods in self.of.items():
            for method, curve in methods.items():
                for seed, k in np.ndindex(curve.rmse_m.shape):
                    place = int(curve.iteration[k]), float(curve.rmse_m[seed, k])
                    yield noise, seed, method.replace(",", ""), *place

    def ratio(self, noise: str, method: str, other: str) -> float:
        """Return the error of one method over that of another at the end of the run.

        It is the median of the seeds' ratios: both methods saw the same worlds.
        """
        ends = (self.of[noise][name].rmse_m[:, -1] for name in (method, other))
        return float(np.median(np.divide(*ends)))


def plot_errors(data: ErrorCurves) -> Figure:
    """Draw a panel for each noise: medians of the seeds, and each seed thinly."""
    figure = blank(6.2 * len(data.of), 6.2)
    panels = figure.subplots(1, len(data.of), sharey=True, squeeze=False)[0]
    style: dict[str, Any] = {"frameon": False, "fontsize": 9, "bbox_to_anchor": (0.5, -0.1)}
    for axes, (noise, methods) in zip(panels, data.of.items(), strict=True):
        for (name, curve), colour in zip(methods.items(), COLOURS, strict=False):
            _draw(axes, name, curve, colour)
        seeds = len(next(iter(methods.values())).rmse_m)
        what = f"median of {seeds} seeds, each seed thinly" if seeds > 1 else "one seed"
        finish(axes, f"{noise} noise ({what})", "iteration", "")
        axes.legend(loc="upper center", **style)
    _scale(panels[0])
    panels[0].set_ylabel("landmark RMSE after rigid alignment [m]")
    figure.suptitle("Figure 16: landmark error over the run", fontsize=11)
    return figure


def _draw(axes: Axes, name: str, curve: Curve, colour: str) -> None:
    if len(curve.rmse_m) > 1:
        axes.plot(curve.iteration, curve.rmse_m.T, color=colour, linewidth=0.6, alpha=0.25)
    median = np.median(curve.rmse_m, axis=0)
    label = f"{name}: {curve.end_m:.4f} m at the end"
    axes.plot(curve.iteration, median, color=colour, linewidth=2.0, label=label)


def _scale(axes: Axes) -> None:
    """Make the shared axis logarithmic, its numbers written in full."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(10, (1, 2, 3, 5)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
