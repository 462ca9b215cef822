"""Figure 15: the run time over the number of visible landmarks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import nnls

from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.figures.timing import MACHINE, median_times, n_log_n, warm_up
from relmap.plots.sheet import BLUE, GREY, ORANGE, blank, finish, write_in_full
from relmap.simulation import simulate_figure_eight

DENSITIES = (12, 25, 50, 100, 200, 400, 700, 1200, 1900)
"""About 0.85 of them are visible."""
QUICK_DENSITIES = (12, 50, 150, 500)
REPEATS, QUICK_REPEATS = 9, 1
QUICK_ITERATIONS = 300
MANY = 100.0
"""So many landmarks are visible where the growth of the run time is read off."""


@dataclass(frozen=True, eq=False)
class DensityTiming:
    """Processor time per iteration in worlds of different density.

    Attributes
    ----------
    visible : (k,) float64, ascending
        Average number of landmarks in a scan.
    median_ms, mean_ms : (k,) float64
    """

    visible: NDArray[np.float64]
    median_ms: NDArray[np.float64]
    mean_ms: NDArray[np.float64]

    @property
    def first(self) -> int:
        """Where growth is read off from: the first with `MANY` visible, two being there to grow."""
        return min(int(np.searchsorted(self.visible, MANY)), max(len(self.visible) - 2, 0))

    @property
    def growth(self) -> tuple[float, float, float]:
        """By what factor n log n, the median and the mean grow from `first` to the last."""
        kinds = (n_log_n(self.visible), self.median_ms, self.mean_ms)
        bound, median, mean = (float(values[-1] / values[self.first]) for values in kinds)
        return bound, median, mean

    @property
    def said(self) -> str:
        """How the times grow from `MANY` visible landmarks on, beside n log n, in ratios."""
        bound, median, mean = self.growth
        verdict = "within" if max(median, mean) <= bound else "more than"
        return (
            f"{verdict} n log n: from {self.visible[self.first]:.0f} to {self.visible[-1]:.0f} "
            f"visible, n log n x {bound:.1f}, median time x {median:.1f}, mean x {mean:.1f}"
        )


def fit_n_log_n(n: NDArray[np.float64], time_ms: NDArray[np.float64]) -> tuple[float, float]:
    """Fit ``a + b n log2 n``, neither negative, by least squares of the relative errors.

    Parameters
    ----------
    n, time_ms : (k,) float64

    Returns
    -------
    a, b : float
        Milliseconds.
    """
    terms = np.column_stack([np.ones(len(n)), n_log_n(n)])
    a, b = nnls(terms / time_ms[:, None], np.ones(len(n)))[0]
    return float(a), float(b)


def _run(quick: bool, data: Path | None, watch: Watch) -> Outcome:
    """Map worlds of all densities."""
    warm_up()
    found = []
    for density in watch(QUICK_DENSITIES if quick else DENSITIES):
        iterations = QUICK_ITERATIONS if quick else 900
        log = simulate_figure_eight(density, iterations).log
        times_ms = median_times(log, QUICK_REPEATS if quick else REPEATS)
        visible = len(log.points_robot) / len(log)
        found.append((visible, float(np.median(times_ms)), float(np.mean(times_ms))))
    return outcome(DensityTiming(*np.array(found).T))


def outcome(data: DensityTiming) -> Outcome:
    """Judge the times at all densities."""
    bound, median, mean = data.growth
    return Outcome(
        lambda: plot_density_timing(data),
        Table(
            ("visible", "median_ms", "mean_ms"),
            list(zip(data.visible, data.median_ms, data.mean_ms, strict=True)),
        ),
        median / bound,
        "growth of the median time over that of n log n",
        f"From {data.visible[data.first]:.0f} to {data.visible[-1]:.0f} visible landmarks n log n "
        f"grows by a factor of {bound:.1f}, the median time of {median:.1f}, the mean of "
        f"{mean:.1f}.",
        judged(median <= bound, mean <= bound),
    )


def plot_density_timing(data: DensityTiming) -> Figure:
    """Draw the time of an iteration over the number of visible landmarks (Fig. 15)."""
    figure = blank(7.8, 5.8)
    axes = figure.subplots()
    n = np.geomspace(data.visible[0], data.visible[-1], 200)
    kinds = (("mean", data.mean_ms, ORANGE, "s"), ("median", data.median_ms, BLUE, "o"))
    for name, times, colour, marker in kinds:
        a, b = fit_n_log_n(data.visible, times)
        axes.plot(data.visible, times, marker, color=colour, label=f"{name} of the iterations")
        label = f"fit: {a:.2f} ms + {1e6 * b:.0f} ns × n log₂ n"
        axes.plot(n, a + b * n_log_n(n), "--", color=colour, linewidth=1.0, label=label)
    bound = n_log_n(n) * data.mean_ms[-1] / n_log_n(n[-1:])
    axes.plot(n, bound, ":", color=GREY, linewidth=1.6, label="slope of n log₂ n alone")
    axes.set(xscale="log", yscale="log", ylim=(data.median_ms.min() / 2, 2 * data.mean_ms.max()))
    write_in_full(axes.xaxis, data.visible)
    write_in_full(axes.yaxis, np.concatenate([data.median_ms, data.mean_ms]))
    title = f"Figure 15: run time over what is visible {MACHINE}\n{data.said}"
    finish(axes, title, "landmarks visible n, on average", "processor time of an iteration [ms]")
    axes.legend(fontsize=8, loc="upper left")
    return figure


FIGURE = PaperFigure(
    name="15",
    title="run time over what is visible",
    claim="An iteration takes O(n log n) for n visible landmarks.",
    criterion=(
        f"from {MANY:.0f} visible landmarks on, median and mean time grow no faster than "
        "n log n; partly where one of the two does not"
    ),
    run=_run,
)
