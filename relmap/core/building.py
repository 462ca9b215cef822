"""Building the map: groups are grown, averaged, and aligned to what is mapped (section III)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid
from relmap.core.chart import PointChart
from relmap.core.completion import RelativeMap, complete
from relmap.core.dynamics import FEWEST, Binning, DynamicStatus, rests
from relmap.core.globalmap import GlobalMap
from relmap.core.grouping import Group, grow_group
from relmap.core.landmarks import MappedGroup
from relmap.core.noise import NoiseEstimate, guess_noise
from relmap.core.schedule import GroupingSchedule
from relmap.core.store import ObservationStore

LONGEST_INTERVAL = 256
"""Iterations that are kept at most, however long a landmark has found no group."""

AMPLE = 1.25
"""A relative map is fitted to again where it came to hold so many times its members."""
FEW = 0.3
"""Share of a chart in the static bin below which the noise may have grown."""

AverageInBasis = Callable[[NDArray[np.float64]], NDArray[np.float64] | None]
"""Averages a group's block (g, i, d) in its consistent basis to (g, d); None if it fixes none."""


class MapBuilder:
    """Turns stored observations into a map, group by group.

    Parameters
    ----------
    store : ObservationStore
    schedule : GroupingSchedule
    average_in_basis : callable
        The variant's relative map.
    """

    def __init__(
        self,
        store: ObservationStore,
        schedule: GroupingSchedule,
        average_in_basis: AverageInBasis,
    ) -> None:
        self.map = GlobalMap()
        self.dynamics = DynamicStatus()
        self.noise = NoiseEstimate()
        self.groups: list[MappedGroup] = []
        self._store = store
        self._schedule = schedule
        self._average_in_basis = average_in_basis

    def resize(self, n: int) -> None:
        """Make room for landmarks 0 to n - 1."""
        if n <= len(self.map.weights):
            return
        self.map.resize(n, self._store.dimension)
        self.dynamics.resize(n)

    def forget(self) -> None:
        """Drop the observations that no later group needs: the relative maps hold them."""
        end = self._store.n_iterations
        oldest = self._schedule.oldest_needed
        self._store.forget(max(end if oldest is None else oldest, end - LONGEST_INTERVAL))

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark go on in place of a new one, which turned out to be it."""
        self.map.merge(new, old)
        self.dynamics.merge(new, old)

    def group(self, seed: int, fixes: int) -> bool:
        """Grow a group around a landmark and align it to the map; tell whether it could be.

        Parameters
        ----------
        seed : int
        fixes : int
            How few mapped landmarks fix a group.
        """
        chart, block = self._chart(seed)
        for piece in self.map.pieces_of(chart.landmarks, fixes):
            weights = self.map.weights_in(piece, chart.landmarks)
            averaged = self._average(chart, block, weights, fixes + 1, fixes)
            if averaged is None:
                continue
            relative = averaged[0]
            placed = self.map.align(piece, relative.landmarks, relative.positions, relative.n_used)
            if placed is not None:
                self._place(piece, placed, *averaged)
                return True
        return False

    def found_piece(self, seed: int, fixes: int) -> bool:
        """Begin the map, or a new piece of it where what is in view is not enough to go on.

        The frame is that of the robot in the first iteration of the group.
        """
        mapped_in_view = np.sum(self.map.weights[self._schedule.in_view] > 0)
        if mapped_in_view >= fixes or self.dynamics.dynamic[seed]:
            return False
        chart, block = self._chart(seed)
        from_the_start = chart.visible[:, 0]
        chart, block = chart.only(from_the_start), block[from_the_start]
        averaged = self._average(chart, block, np.zeros(len(block)), fixes + 1, 0)
        if averaged is None:
            return False
        relative = averaged[0]
        first = block[np.isin(chart.landmarks, relative.landmarks), 0]
        if len(first) <= fixes:
            return False
        R, t = fit_rigid(relative.positions, first)
        self._place(self.map.new_piece(), relative.positions @ R.T + t, *averaged)
        return True

    def _place(
        self,
        piece: int,
        placed: NDArray[np.float64],
        relative: RelativeMap,
        common_interval: NDArray[np.int64],
    ) -> None:
        """Average a relative map, placed in the frame of a piece, into the map; keep it."""
        landmarks = relative.landmarks
        unused = relative.used & (relative.iterations >= self._schedule.begin[landmarks][:, None])
        n_unused = unused.sum(axis=1)
        self.map.average_in(piece, landmarks, placed, n_unused.astype(np.float64))
        self._schedule.grouped(landmarks, self._store.n_iterations)
        self.groups.append(
            MappedGroup(
                landmarks=landmarks,
                relative_map=relative.positions,
                n_observations=n_unused,
                iterations=common_interval,
                fitted=relative.iterations[relative.fixed],
                R=relative.R[relative.fixed],
                t=relative.t[relative.fixed],
            )
        )

    def _chart(self, seed: int) -> tuple[PointChart, NDArray[np.float64]]:
        end = self._store.n_iterations
        begin = max(self._schedule.begin[seed], self._store.first_iteration)
        chart = PointChart.around(seed, self._store, begin, end)
        return chart, self._store.gather(chart.landmarks, chart.iterations)

    def _average(
        self,
        chart: PointChart,
        block: NDArray[np.float64],
        weights: NDArray[np.float64],
        min_members: int,
        min_shared: int,
    ) -> tuple[RelativeMap, NDArray[np.int64]] | None:
        """Average the static landmarks of a chart; take note of the dynamic ones.

        Returns
        -------
        (relative map, common interval) or None
            None where no group can be grown, or it fixes no basis.
        """
        static = self._static(chart, block, weights)
        group = grow_group(chart, static, weights, min_members, min_shared)
        if group is None:
            return None
        core = block[group.rows][:, group.columns]
        average = self._average_in_basis(core)
        if average is None:
            return None
        self.noise.add(core)
        relative = self._completed(chart, block, group, average)
        at_rest = self.dynamics.test(relative, self.noise.sigma_m)
        moving = relative.landmarks[self.dynamics.dynamic[relative.landmarks]]
        self.map.remove(moving)
        self._schedule.grouped(moving, self._store.n_iterations)
        return relative.only(at_rest), chart.iterations[group.columns]

    def _completed(
        self,
        chart: PointChart,
        block: NDArray[np.float64],
        group: Group,
        average: NDArray[np.float64],
    ) -> RelativeMap:
        """Complete a relative map to all of the chart: first from the group, then from all at rest.

        Few members leave the far end of the chart free to swing.
        """
        reference = np.full((len(block), block.shape[2]), np.nan)
        reference[group.rows] = average
        relative = complete(chart.landmarks, chart.iterations, block, reference)
        steady = (relative.n_used >= FEWEST) & rests(relative, self.noise.sigma_m)
        steady &= ~self.dynamics.dynamic[relative.landmarks]
        if steady.sum() > AMPLE * len(group.rows):
            rows = np.flatnonzero(np.isin(chart.landmarks, relative.landmarks))[steady]
            reference = np.full_like(reference, np.nan)
            reference[rows] = relative.positions[steady]
            relative = complete(chart.landmarks, chart.iterations, block, reference)
        return relative

    def _static(
        self,
        chart: PointChart,
        block: NDArray[np.float64],
        weights: NDArray[np.float64],
    ) -> NDArray[np.int64]:
        """Return the rows of the chart that keep their distances and were not seen moving."""
        noise_m = self.noise.sigma_m
        bins = Binning(block, noise_m).sort(weights) if np.isfinite(noise_m) else None
        if bins is None or len(bins.static) < FEW * len(block):
            guess_m = guess_noise(block)
            if bins is None or guess_m > noise_m:
                guessed = Binning(block, guess_m).sort(weights)
                if bins is None or len(guessed.static) > len(bins.static):
                    self.noise.restart()
                    bins = guessed
        static = bins.static
        return static[~self.dynamics.dynamic[chart.landmarks[static]]]
