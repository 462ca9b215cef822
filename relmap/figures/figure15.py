"""Figure 15: the run time over the number of visible landmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.figures.base import Outcome, Table, Watch, judged, unwatched
from relmap.figures.timing import median_times, warm_up
from relmap.plots.curves import MANY, DensityTiming, plot_density_timing
from relmap.simulation import simulate_figure_eight

DENSITIES = (12, 25, 50, 100, 200, 400, 700, 1200, 1900)
"""About 0.85 of them are visible."""
QUICK_DENSITIES = (12, 50, 150, 500)
REPEATS, QUICK_REPEATS = 9, 1
QUICK_ITERATIONS = 300


class DensityTimeFigure:
    """Processor time of an iteration in worlds of growing density."""

    name = "15"
    title = "run time over what is visible"
    claim = "An iteration takes O(n log n) for n visible landmarks."
    criterion = (
        f"from {MANY:.0f} visible landmarks on, median and mean time grow no faster than "
        "n log n; partly where one of the two does not"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
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
