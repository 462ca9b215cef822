"""From a chart to a relative map: static landmarks, group, and average (Fig. 8)."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.grouping.chart import Group, PointChart
from relmap.core.grouping.completion import RelativeMap, complete
from relmap.core.grouping.dynamics import FEWEST, Bins, DynamicStatus, binned, n_log_n
from relmap.core.grouping.noise import NoiseEstimate, guess_noise
from relmap.core.state.table import LandmarkState

FEW = 0.2
"""Fraction of a chart, and of its known landmarks, in the static bin, below which the bin is
doubted."""
LONG = 20
"""Iterations that distinguish landmarks moving together from coincidence."""


class Averaging:
    """Estimates from charts the noise and which landmarks move.

    `noise_spread`: ratio of the largest to the typical noise of a landmark.

    Attributes: `n_comparisons`: pairs of landmarks compared in the last chart.
    """

    STATE = "noise n_comparisons _motion"

    def __init__(self, table: LandmarkState, noise_spread: float) -> None:
        self.noise = NoiseEstimate()
        self.n_comparisons = 0
        self._table = table
        self._motion = DynamicStatus(table)
        self._noise_spread = noise_spread

    @property
    def _tolerated_m(self) -> float:
        """Allowed standard deviation of a static landmark, metres."""
        return self._noise_spread * self.noise.sigma_m

    def completed(self, chart: PointChart, group: Group, average: Floats) -> RelativeMap:
        """Complete a group's relative map by all static landmarks of its chart; update motion.

        `average` (g, d), group frame, metres: the relative map.
        """
        self.noise.add(group.points_robot)
        reference = np.full((len(chart.landmarks), average.shape[1]), np.nan)
        reference[group.rows] = average
        moves = self._table.dynamic[chart.landmarks]
        relative = complete(chart, reference, moves, self._tolerated_m)
        at_rest = self._motion.test(relative, self._tolerated_m)
        self._bin_movers(chart)
        resting = relative.only(at_rest)
        resting.common_interval = chart.iterations[group.columns]
        return resting

    def static(self, chart: PointChart, weights: Floats) -> Ints:
        """Return the rows of the chart that keep their distances and are not known to move."""
        self.n_comparisons = 0
        block, noise_m = chart.points_robot, self._tolerated_m
        bins = (
            binned(block, noise_m, weights, counts=chart.counted)
            if np.isfinite(noise_m)
            else Bins([], 0)
        )
        self.n_comparisons += bins.n_comparisons
        few = len(bins.static) < FEW * len(block)
        if few and weights[bins.static].sum() < FEW * max(weights.sum(), 1.0):
            guess_m = self._noise_spread * np.fmax(guess_noise(block), self.noise.least_m)
            if not guess_m <= noise_m:
                guessed = binned(block, guess_m, weights, counts=chart.counted)
                self.n_comparisons += guessed.n_comparisons
                if len(guessed.static) > len(bins.static):
                    self.noise.restart()
                    bins = guessed
        static = bins.static
        return static[~self._table.dynamic[chart.landmarks[static]]]

    def _bin_movers(self, chart: PointChart) -> None:
        """Record which landmarks move together, as the parts of a vehicle do.

        Comparisons are limited to the n log2 n of the whole chart.
        """
        often = chart.common_interval >= FEWEST
        rest = (often & self._table.dynamic[chart.landmarks]).nonzero()[0]
        if len(chart.iterations) < LONG or not len(rest):
            return
        allowed = n_log_n(int(often.sum()))
        together: list[Ints] = []
        while len(rest) > 1 and self.n_comparisons < allowed:
            block, none = chart.points_robot[rest], np.zeros(len(rest))
            bins = binned(block, self._tolerated_m, none, allowed - self.n_comparisons)
            self.n_comparisons += bins.n_comparisons
            if not bins.members:
                break
            together += [chart.landmarks[rest[members]] for members in bins.members]
            rest = np.delete(rest, np.concatenate(bins.members))
        compared = self.n_comparisons + len(rest) <= allowed  # none was skipped for lack of budget
        alone = chart.landmarks[rest] if compared else rest[:0]
        self._motion.go_together(together, alone)
