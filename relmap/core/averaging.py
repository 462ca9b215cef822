"""From a chart to a relative map: who is static, who forms the group, and the average (Fig. 8)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from relmap.core.chart import PointChart
from relmap.core.completion import RelativeMap, complete
from relmap.core.dynamics import FEWEST, Binning, Bins, DynamicStatus, n_log_n, rests
from relmap.core.grouping import Group, grow_group
from relmap.core.noise import NoiseEstimate, guess_noise

ROUNDS = 6
"""How often a relative map is fitted to again as it comes to hold more."""
AMPLE = 1.5
"""It is fitted to again where so many times as much of it is placed well enough."""
SOLID = 1.0
"""Largest variance of a position that is fitted to, in units of an observation's."""
FEW = 0.2
"""Share of a chart, and of what is known of it, in the static bin, below which it is doubted."""
LONG = 20
"""Iterations that tell landmarks which move together from those that happen to."""

AverageInBasis = Callable[[NDArray[np.float64]], NDArray[np.float64] | None]
"""Averages a group's block (g, i, d) in its consistent basis to (g, d); None if it fixes none."""


class Averaging:
    """Averages charts, and learns from them how large the noise is and which landmarks move.

    Parameters
    ----------
    average_in_basis : callable
        The variant's relative map.
    noise_spread : float
        How many times noisier than the typical the noisiest of the variant's landmarks are.

    Attributes
    ----------
    dynamics : DynamicStatus
    noise : NoiseEstimate
    n_comparisons : int
        Pairs of landmarks compared in the last chart.
    """

    def __init__(self, average_in_basis: AverageInBasis, noise_spread: float = 1.0) -> None:
        self.dynamics = DynamicStatus()
        self.noise = NoiseEstimate()
        self.n_comparisons = 0
        self._average_in_basis = average_in_basis
        self._noise_spread = noise_spread

    @property
    def _tolerated_m(self) -> float:
        """Standard deviation that a landmark at rest may have, metres."""
        return self._noise_spread * self.noise.sigma_m

    def average(
        self,
        chart: PointChart,
        weights: NDArray[np.float64],
        min_members: int,
        min_shared: int,
    ) -> tuple[RelativeMap, Group] | None:
        """Average the static landmarks of a chart; take note of the dynamic ones.

        Parameters
        ----------
        chart : PointChart
        weights : (n,) float64
            How well each landmark of the chart is mapped; 0 if it is not.
        min_members, min_shared : int
            Smallest size of a group, and of what it shares with the map.

        Returns
        -------
        (relative map, group) or None
            The map holds all at rest, the group is the core that it began with; None where no
            group can be grown, or it fixes no basis.
        """
        self.n_comparisons = 0
        static = self._static(chart, weights)
        group = grow_group(chart, static, weights, min_members, min_shared)
        if group is None:
            return None
        core = chart.points_robot[group.rows][:, group.columns]
        average = self._average_in_basis(core)
        if average is None:
            return None
        self.noise.add(core)
        relative = self._completed(chart, group, average)
        at_rest = self.dynamics.test(relative, self._tolerated_m)
        self._bin_movers(chart)
        return relative.only(at_rest), group

    def _completed(
        self, chart: PointChart, group: Group, average: NDArray[np.float64]
    ) -> RelativeMap:
        """Complete a relative map to all of the chart, from the group outwards.

        Few members leave the far end of the chart free to swing: what is placed well enough from
        them is fitted to as well, until there is no more.
        """
        landmarks, block = chart.landmarks, chart.points_robot
        reference = np.full((len(block), block.shape[2]), np.nan)
        reference[group.rows] = average
        n_members = len(group.rows)
        for _ in range(ROUNDS):
            relative = complete(landmarks, chart.iterations, block, reference)
            solid = (relative.n_used >= FEWEST) & rests(relative, self._tolerated_m)
            solid &= ~self.dynamics.dynamic[relative.landmarks]
            solid &= relative.amplified <= SOLID * relative.n_used
            if solid.sum() <= AMPLE * n_members:
                break
            n_members = int(solid.sum())
            reference = np.full_like(reference, np.nan)
            reference[np.isin(landmarks, relative.landmarks[solid])] = relative.positions[solid]
        return relative

    def _static(self, chart: PointChart, weights: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the rows of the chart that keep their distances and were not seen moving."""
        block, noise_m = chart.points_robot, self._tolerated_m
        bins = Binning(block, noise_m).sort(weights) if np.isfinite(noise_m) else Bins([], 0)
        self.n_comparisons += bins.n_comparisons
        known = weights[bins.static].sum() / max(weights.sum(), 1.0)
        if len(bins.static) < FEW * len(block) and known < FEW:
            guess_m = self._noise_spread * guess_noise(block)
            if not guess_m <= noise_m:
                guessed = Binning(block, guess_m).sort(weights)
                self.n_comparisons += guessed.n_comparisons
                if len(guessed.static) > len(bins.static):
                    self.noise.restart()
                    bins = guessed
        static = bins.static
        return static[~self.dynamics.dynamic[chart.landmarks[static]]]

    def _bin_movers(self, chart: PointChart) -> None:
        """Take note of which landmarks move together, as the parts of a vehicle do.

        They are compared as far as the n log2 n comparisons of the whole chart go.
        """
        if len(chart.iterations) < LONG:
            return
        often = chart.visible.sum(axis=1) >= FEWEST
        allowed = n_log_n(int(often.sum()))
        rest = np.flatnonzero(often & self.dynamics.dynamic[chart.landmarks])
        together: list[NDArray[np.int64]] = []
        while len(rest) > 1 and self.n_comparisons < allowed:
            binning = Binning(chart.points_robot[rest], self._tolerated_m)
            bins = binning.sort(np.zeros(len(rest)), allowed - self.n_comparisons)
            self.n_comparisons += bins.n_comparisons
            if not bins.members:
                break
            together += [chart.landmarks[rest[members]] for members in bins.members]
            rest = np.delete(rest, np.concatenate(bins.members))
        compared = self.n_comparisons + len(rest) <= allowed  # none was left out for want of room
        alone = chart.landmarks[rest] if compared else rest[:0]
        self.dynamics.go_together(together, alone)
