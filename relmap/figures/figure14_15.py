"""Figures 14 and 15: the run time over one loop, and over the number of visible landmarks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import nnls
from threadpoolctl import threadpool_limits

from relmap.core.arrays import Floats, Ints
from relmap.datasets.base import ObservationLog
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged, n_log_n, sentence
from relmap.plots.sheet import BLUE, GREY, ORANGE, RED, blank, finish, write_in_full
from relmap.points.mapper import PointMapper
from relmap.simulation import simulate_figure_eight

REPEATS, QUICK_REPEATS = 9, 1
DENSITY, QUICK_DENSITY = 1000.0, 300.0
DENSITIES = (12, 25, 50, 100, 200, 400, 700, 1200, 1900)
"""About 0.85 of them are visible."""
QUICK_DENSITIES = (12, 50, 150, 500)
ITERATIONS, QUICK_ITERATIONS = 900, 300
BEGINNING = 25
"""Iterations in which a map begins, excluded from the comparison of start and end of a loop."""
HALF_WINDOW = 25
"""Half width of the window of running medians and means."""
FLAT = 1.2
"""Growth of the time per visible landmark that still counts as none."""
MANY = 100.0
"""Number of visible landmarks above which the growth of the run time is measured."""
MACHINE = "(milliseconds of one machine: compare ratios)"


@dataclass(frozen=True, eq=False)
class LoopTiming:
    """One loop, iteration by iteration.

    `time_ms` (i,): processor time; `visible` (i,): landmarks in the scan; `landmarks`,
    `true_landmarks` (i,): landmarks seen so far: according to the mapper, and truly.
    """

    time_ms: Floats
    visible: Ints
    landmarks: Ints
    true_landmarks: Ints

    @property
    def growth_each(self) -> tuple[float, float]:
        """Factors by which median and mean time per visible landmark change over the loop."""
        each_ms = self.time_ms / np.maximum(self.visible, 1)
        return _growth(each_ms), _growth(each_ms, np.mean)

    @property
    def said(self) -> str:
        """Comparison of the last quarter of the loop with the first, in ratios."""
        median, mean = self.growth_each
        flat = "not flat" if median > FLAT else "flat in the median, not in the mean"
        return (
            f"{'flat' if max(median, mean) <= FLAT else flat}: last quarter to first (from "
            f"{BEGINNING} on), landmarks x {_growth(self.landmarks):.1f},\n"
            f"median time x {_growth(self.time_ms):.2f} (per visible landmark x {median:.2f}), "
            f"mean x {_growth(self.time_ms, np.mean):.2f} (x {mean:.2f})"
        )


@dataclass(frozen=True, eq=False)
class DensityTiming:
    """Processor time per iteration in worlds of different density.

    `visible` (k,), ascending: average number of landmarks in a scan; `median_ms`, `mean_ms` (k,).
    """

    visible: Floats
    median_ms: Floats
    mean_ms: Floats

    @property
    def _first(self) -> int:
        """The first world with `MANY` visible; at least two are left to compare."""
        return min(int(np.searchsorted(self.visible, MANY)), max(len(self.visible) - 2, 0))

    @property
    def growth(self) -> tuple[float, float, float]:
        """Factors by which n log n, median and mean grow from `MANY` visible landmarks on."""
        kinds = (n_log_n(self.visible), self.median_ms, self.mean_ms)
        bound, median, mean = (float(values[-1] / values[self._first]) for values in kinds)
        return bound, median, mean

    @property
    def said(self) -> str:
        """Comparison of the growth of the times with n log n, in ratios."""
        bound, median, mean = self.growth
        verdict = "within" if max(median, mean) <= bound else "more than"
        return (
            f"{verdict} n log n: from {self.visible[self._first]:.0f} to {self.visible[-1]:.0f} "
            f"visible, n log n x {bound:.1f}, median time x {median:.1f}, mean x {mean:.1f}"
        )


def _timed(log: ObservationLog) -> tuple[Floats, Ints]:
    """Return the time of each iteration without ids, ms, and the landmark of each observation."""
    mapper, times_s, labels = PointMapper(), [], []
    with threadpool_limits(1):
        for scan in log.scans():
            began = process_time()
            labels.append(mapper.update(scan.points_robot))
            times_s.append(process_time() - began)
    return 1e3 * np.array(times_s), mapper.landmarks_of(np.concatenate(labels))


def median_times(log: ObservationLog, repeats: int, watch: Watch = iter) -> Floats:
    """Return the time of each iteration (i,), ms: the median of several runs without ids."""
    return np.asarray(np.median([_timed(log)[0] for _ in watch(range(repeats))], axis=0))


def _compile() -> None:
    _timed(simulate_figure_eight(density=100, iterations=100).log)


def _growth(values: NDArray[Any], of: Any = np.median) -> float:
    """Return by what factor the median, or `of`, of values (i,) changes, first to last quarter."""
    quarter = max(len(values) // 4, 1)
    begin = min(BEGINNING, len(values) - quarter)
    return float(of(values[-quarter:]) / of(values[begin : begin + quarter]))


def _running(values: Floats, of: Any) -> Floats:
    """Return `of`, ``numpy.median`` or such, of the values (i,) around each one; (i,)."""
    return np.array(
        [of(values[max(k - HALF_WINDOW, 0) : k + HALF_WINDOW + 1]) for k in range(len(values))]
    )


def seen_so_far(landmarks: Ints, log: ObservationLog) -> Ints:
    """Return how many of the landmarks (n,) were seen up to each iteration of a log; (i,)."""
    _, first = np.unique(landmarks, return_index=True)
    return np.cumsum(np.bincount(log.iteration[first], minlength=len(log)))


def _run_loop(quick: bool, data: Path | None, watch: Watch) -> LoopTiming:
    _compile()
    log = simulate_figure_eight(density=QUICK_DENSITY if quick else DENSITY).log
    times_ms = median_times(log, QUICK_REPEATS if quick else REPEATS, watch)
    assert log.ids is not None
    visible = np.bincount(log.iteration, minlength=len(log))
    known, truly = seen_so_far(_timed(log)[1], log), seen_so_far(log.ids, log)
    return LoopTiming(times_ms, visible, known, truly)


def _judge_loop(data: LoopTiming) -> Outcome:
    median, mean = data.growth_each
    columns = {"iteration": np.arange(len(data.time_ms)), **vars(data)}
    return Outcome(
        Table(list(columns), list(zip(*columns.values(), strict=True))),
        median,
        f"{sentence(data.said)} {data.landmarks[-1]} landmarks are known at the end. "
        f"An iteration takes {np.median(data.time_ms):.2f} ms (median; mean "
        f"{np.mean(data.time_ms):.2f} ms) with {np.mean(data.visible):.0f} landmarks visible.",
        judged(median <= FLAT, mean <= FLAT),
    )


def _plot_loop(data: LoopTiming) -> Figure:
    """Draw the time of each iteration of a loop above the number of landmarks."""
    figure = blank(9.2, 6.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.5, 1.0])
    i = np.arange(len(data.time_ms))
    dots: dict[str, Any] = {"markersize": 2, "linestyle": "", "color": "#b5b5b5"}
    above.plot(i, data.time_ms, "o", label="one iteration", **dots)
    for of, name, colour in ((np.mean, "mean", ORANGE), (np.median, "median", BLUE)):
        label = f"running {name}, {2 * HALF_WINDOW + 1} iterations"
        above.plot(i, _running(data.time_ms, of), color=colour, linewidth=1.8, label=label)
    lowest, highest = float(data.time_ms.min()), float(data.time_ms.max())
    above.set(yscale="log", ylim=(lowest / 1.5, 2.5 * highest))
    write_in_full(above.yaxis)
    title = f"Figure 14: run time over one loop {MACHINE}\n{data.said}"
    finish(above, title, "", "processor time of an iteration [ms]")
    above.legend(fontsize=8, loc="upper center", ncols=3)
    below.plot(i, data.landmarks, color=BLUE, label="landmarks known to relmap")
    below.plot(i, data.true_landmarks, "--", color=RED, label="true landmarks seen so far")
    below.plot(i, data.visible, color=GREY, linewidth=1.0, label="visible in the iteration")
    finish(below, "", "iteration", "number of landmarks")
    below.set_ylim(0, 1.1 * float(data.landmarks.max()))
    below.legend(fontsize=8, loc="upper left")
    return figure


def fit_n_log_n(n: Floats, time_ms: Floats) -> tuple[float, float]:
    """Fit ``a + b n log2 n``, neither negative, to times (k,), ms, by relative least squares."""
    terms = np.column_stack([np.ones(len(n)), n_log_n(n)])
    a, b = nnls(terms / time_ms[:, None], np.ones(len(n)))[0]
    return float(a), float(b)


def _run_densities(quick: bool, data: Path | None, watch: Watch) -> DensityTiming:
    _compile()
    found = []
    for density in watch(QUICK_DENSITIES if quick else DENSITIES):
        log = simulate_figure_eight(density, QUICK_ITERATIONS if quick else ITERATIONS).log
        times_ms = median_times(log, QUICK_REPEATS if quick else REPEATS)
        found.append((len(log.points_robot) / len(log), np.median(times_ms), np.mean(times_ms)))
    return DensityTiming(*np.array(found, dtype=np.float64).T)


def _judge_densities(data: DensityTiming) -> Outcome:
    bound, median, mean = data.growth
    return Outcome(
        Table(list(vars(data)), list(zip(*vars(data).values(), strict=True))),
        median / bound,
        sentence(data.said),
        judged(median <= bound, mean <= bound),
    )


def _plot_densities(data: DensityTiming) -> Figure:
    """Draw the time of an iteration over the number of visible landmarks."""
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
    write_in_full(axes.xaxis)
    write_in_full(axes.yaxis)
    title = f"Figure 15: run time over visible landmarks {MACHINE}\n{data.said}"
    finish(axes, title, "landmarks visible n, on average", "processor time of an iteration [ms]")
    axes.legend(fontsize=8, loc="upper left")
    return figure


LOOP = PaperFigure(
    name="14",
    title="run time over one loop",
    claim=(
        "An iteration takes as long at the end of the loop as at its beginning, although the map "
        "grows from nothing to 7400 landmarks."
    ),
    criterion=(
        "from the first quarter of the loop to the last, median and mean time per visible landmark "
        f"grow by a factor of {FLAT:g} at most; partly where one of the two does"
    ),
    unit="median time per visible landmark: last quarter of the loop over the first",
    run=_run_loop,
    judge=_judge_loop,
    draw=_plot_loop,
)
VISIBLE = PaperFigure(
    name="15",
    title="run time over the number of visible landmarks",
    claim="An iteration takes O(n log n) for n visible landmarks.",
    criterion=(
        f"from {MANY:.0f} visible landmarks on, median and mean time grow no faster than "
        "n log n; partly where one of the two does not"
    ),
    unit="growth of the median time over that of n log n",
    run=_run_densities,
    judge=_judge_densities,
    draw=_plot_densities,
)
FIGURES = (LOOP, VISIBLE)
