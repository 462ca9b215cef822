"""Figure 14: the run time over one loop."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relmap.datasets.base import ObservationLog
from relmap.figures.base import Outcome, PaperFigure, Table, Watch, judged
from relmap.figures.timing import MACHINE, median_times, timed, warm_up
from relmap.plots.sheet import BLUE, GREY, ORANGE, RED, blank, finish, write_in_full
from relmap.simulation import simulate_figure_eight

REPEATS, QUICK_REPEATS = 9, 1
DENSITY, QUICK_DENSITY = 1000.0, 300.0
BEGINNING = 25
"""Iterations in which a map begins; left out where the end of a loop is held against its start."""
HALF_WINDOW = 25
"""Iterations before and after that a running median or mean takes in."""
FLAT = 1.2
"""Growth of the time per visible landmark that still counts as none."""


@dataclass(frozen=True, eq=False)
class LoopTiming:
    """One loop, iteration by iteration.

    Attributes
    ----------
    time_ms : (i,) float64
        Processor time.
    visible : (i,) int64
        Landmarks in the scan.
    landmarks, true_landmarks : (i,) int64
        Landmarks seen so far: as the mapper tells them apart, and truly.
    """

    time_ms: NDArray[np.float64]
    visible: NDArray[np.int64]
    landmarks: NDArray[np.int64]
    true_landmarks: NDArray[np.int64]

    @property
    def growth_each(self) -> tuple[float, float]:
        """By what factor median and mean time per visible landmark change over the loop."""
        each_ms = self.time_ms / np.maximum(self.visible, 1)
        return growth(each_ms), growth(each_ms, np.mean)

    @property
    def said(self) -> str:
        """How the last quarter of the loop compares with the first, in ratios."""
        median, mean = self.growth_each
        flat = "not flat" if median > FLAT else "flat in the median, not in the mean"
        return (
            f"{'flat' if max(median, mean) <= FLAT else flat}: last quarter to first (from "
            f"{BEGINNING} on), landmarks x {growth(self.landmarks):.1f},\n"
            f"median time x {growth(self.time_ms):.2f} (per visible landmark x {median:.2f}), "
            f"mean x {growth(self.time_ms, np.mean):.2f} (x {mean:.2f})"
        )


def growth(values: NDArray[Any], of: Any = np.median) -> float:
    """Return by what factor the median, or `of`, of values (i,) changes, first to last quarter.

    The first `BEGINNING` iterations do not count.
    """
    quarter = max(len(values) // 4, 1)
    begin = min(BEGINNING, len(values) - quarter)
    return float(of(values[-quarter:]) / of(values[begin : begin + quarter]))


def running(values: NDArray[np.float64], of: Any) -> NDArray[np.float64]:
    """Return `of`, ``numpy.median`` or such, of the values (i,) around each one; (i,)."""
    return np.array(
        [of(values[max(k - HALF_WINDOW, 0) : k + HALF_WINDOW + 1]) for k in range(len(values))]
    )


def _run(quick: bool, data: Path | None, watch: Watch) -> Outcome:
    """Map a loop several times."""
    warm_up()
    log = simulate_figure_eight(density=QUICK_DENSITY if quick else DENSITY).log
    times_ms = median_times(log, QUICK_REPEATS if quick else REPEATS, watch)
    assert log.ids is not None
    visible = np.bincount(log.iteration, minlength=len(log))
    known, truly = seen_so_far(timed(log)[1], log), seen_so_far(log.ids, log)
    return outcome(LoopTiming(times_ms, visible, known, truly))


def outcome(data: LoopTiming) -> Outcome:
    """Judge a loop."""
    median, mean = data.growth_each
    counts = (data.visible, data.landmarks, data.true_landmarks)
    return Outcome(
        lambda: plot_loop_timing(data),
        Table(
            ("iteration", "time_ms", "visible", "landmarks", "true_landmarks"),
            list(zip(range(len(data.time_ms)), data.time_ms, *counts, strict=True)),
        ),
        median,
        "median time per visible landmark: last quarter of the loop over the first",
        f"While the landmarks known grow by a factor of {growth(data.landmarks):.1f}, to "
        f"{data.landmarks[-1]}, the median time per visible landmark changes by a factor of "
        f"{median:.2f} and the mean, with all costly steps, of {mean:.2f}. "
        f"An iteration takes {np.median(data.time_ms):.2f} ms (median; mean "
        f"{np.mean(data.time_ms):.2f} ms) with {np.mean(data.visible):.0f} landmarks visible.",
        judged(median <= FLAT, mean <= FLAT),
    )


def seen_so_far(landmarks: NDArray[np.int64], log: ObservationLog) -> NDArray[np.int64]:
    """Return how many different landmarks were seen up to each iteration of a log, (i,)."""
    _, first = np.unique(landmarks, return_index=True)
    return np.cumsum(np.bincount(log.iteration[first], minlength=len(log)))


def plot_loop_timing(data: LoopTiming) -> Figure:
    """Draw the time of each iteration of a loop above the number of landmarks (Fig. 14)."""
    figure = blank(9.2, 6.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.5, 1.0])
    i = np.arange(len(data.time_ms))
    dots: dict[str, Any] = {"markersize": 2, "linestyle": "", "color": "#b5b5b5"}
    above.plot(i, data.time_ms, "o", label="one iteration", **dots)
    for of, name, colour in ((np.mean, "mean", ORANGE), (np.median, "median", BLUE)):
        label = f"running {name}, {2 * HALF_WINDOW + 1} iterations"
        above.plot(i, running(data.time_ms, of), color=colour, linewidth=1.8, label=label)
    lowest, highest = float(data.time_ms.min()), float(data.time_ms.max())
    above.set(yscale="log", ylim=(lowest / 1.5, 2.5 * highest))
    write_in_full(above.yaxis, data.time_ms)
    title = f"Figure 14: run time over one loop {MACHINE}\n{data.said}"
    finish(above, title, "", "processor time of an iteration [ms]")
    above.legend(fontsize=8, loc="upper center", ncols=3)
    below.plot(i, data.landmarks, color=BLUE, label="landmarks known, as relmap tells them apart")
    below.plot(i, data.true_landmarks, "--", color=RED, label="true landmarks seen so far")
    below.plot(i, data.visible, color=GREY, linewidth=1.0, label="visible in the iteration")
    finish(below, "", "iteration", "number of landmarks")
    below.set_ylim(0, 1.1 * float(data.landmarks.max()))
    below.legend(fontsize=8, loc="upper left")
    return figure


FIGURE = PaperFigure(
    name="14",
    title="run time over one loop",
    claim=(
        "An iteration takes as long at the end of the loop as at its beginning, though the map "
        "grows from nothing to 7400 landmarks."
    ),
    criterion=(
        "from the first quarter of the loop to the last, median and mean time per visible landmark "
        f"grow by a factor of {FLAT:g} at most; partly where one of the two does"
    ),
    run=_run,
)
