"""Figure 4: of four midpoint pairs, the steadiest is that of the static corners."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.figures.base import Outcome, Table, Watch, judged, unwatched
from relmap.figures.corner_test import SIDES, CornerTest, clearest, corner_tests
from relmap.planes import PlaneMapper
from relmap.plots.corner_test import plot_corner_test
from relmap.segmentation import PlaneSegmenter
from relmap.simulation import simulate_building
from relmap.simulation.sensor import DEPTH_SENSOR

SIGMA_M = 0.02
QUICK_ITERATIONS = 60
OFTEN, MOSTLY = 0.95, 0.5
"""Shares of the pairs of walls for which the claim must hold, to be borne out, and partly so."""
COLUMNS = ("first_wall", "second_wall", "iterations", "chosen_first", "chosen_second",
           "static_first", "static_second", "right")  # fmt: skip


class CornerFigure:
    """The corner test on a drive through a building."""

    name = "4"
    title = "which corners of partly seen walls are real"
    claim = (
        "Of the four pairs of midpoints estimated from either end of two partly seen walls, the "
        "one whose distance deviates least over time belongs to the static corners."
    )
    criterion = (
        f"the pair of lowest deviation is that of the static corners, as the simulator's ends tell "
        f"them, for {OFTEN:.0%} of the pairs of walls; partly for {MOSTLY:.0%}"
    )

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Map a building and test all pairs of walls that have one cut end each."""
        sensor = DEPTH_SENSOR
        building = simulate_building(sigma=SIGMA_M, iterations=QUICK_ITERATIONS if quick else None)
        segmenter = PlaneSegmenter(view_rad=sensor.view_rad, range_m=sensor.range_m)
        mapper = PlaneMapper(segmenter=segmenter)
        for scan in watch(building.scans):
            mapper.update(scan.points)
        return outcome(corner_tests(mapper.history), sensor.view_rad, sensor.range_m)


def outcome(tests: list[CornerTest], view_rad: float, range_m: float) -> Outcome:
    """Draw the clearest of the tests and judge by all of them.

    Raises
    ------
    RelmapError
        Where no pair of walls can be shown.
    """
    shown = clearest(tests)
    share = float(np.mean([test.chosen == test.static for test in tests]))
    rows = [
        (*test.planes, len(test.iterations), *map(SIDES.__getitem__, (*test.chosen, *test.static)),
         int(test.chosen == test.static))
        for test in tests
    ]  # fmt: skip
    return Outcome(
        lambda: plot_corner_test(shown, view_rad, range_m),
        Table(shown.COLUMNS, list(shown.rows())),
        share,
        "share of the pairs of walls with the static corners chosen",
        f"In {share:.0%} of {len(tests)} pairs of walls that show one real and one cut end each, "
        "the lowest deviation is that of the real corners.",
        judged(share >= OFTEN, share >= MOSTLY),
        {"-pairs.csv": Table(COLUMNS, rows).write},
    )
