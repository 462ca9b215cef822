"""Figure 14: the run time over one loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.datasets.base import ObservationLog
from relmap.figures.base import Outcome, Table, Watch, judged, unwatched
from relmap.figures.timing import median_times, timed, warm_up
from relmap.plots.curves import FLAT, LoopTiming, growth, plot_loop_timing
from relmap.simulation import simulate_figure_eight

REPEATS, QUICK_REPEATS = 9, 1
DENSITY, QUICK_DENSITY = 1000.0, 300.0


class LoopTimeFigure:
    """Processor time of every iteration, while the map grows."""

    name = "14"
    title = "run time over one loop"
    claim = (
        "An iteration takes as long at the end of the loop as at its beginning, though the map "
        "grows from nothing to 7400 landmarks."
    )
    criterion = (
        "from the first quarter of the loop to the last, median and mean time per visible landmark "
        f"grow by a factor of {FLAT:g} at most; partly where one of the two does"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
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
