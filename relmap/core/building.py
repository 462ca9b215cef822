"""Building the map: groups are grown, averaged, and aligned to what is mapped (section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid
from relmap.core.averaging import AverageInBasis, Averaging
from relmap.core.chart import PointChart
from relmap.core.completion import RelativeMap
from relmap.core.condensing import CondensedSegments
from relmap.core.dynamics import FEWEST, DynamicStatus
from relmap.core.globalmap import GlobalMap
from relmap.core.landmarks import MappedGroup
from relmap.core.levels import GroupLevels
from relmap.core.noise import NoiseEstimate
from relmap.core.schedule import LONGEST_INTERVAL, GroupingSchedule
from relmap.core.store import ObservationStore


class MapBuilder:
    """Turns stored observations into a map, group by group.

    Parameters
    ----------
    store : ObservationStore
    schedule : GroupingSchedule
    levels : GroupLevels
    average_in_basis : callable
        The variant's relative map.
    noise_spread : float
        How many times noisier than the typical the noisiest of its landmarks are.
    """

    def __init__(
        self,
        store: ObservationStore,
        schedule: GroupingSchedule,
        levels: GroupLevels,
        average_in_basis: AverageInBasis,
        noise_spread: float = 1.0,
    ) -> None:
        self.map = GlobalMap()
        self.levels = levels
        self._averaging = Averaging(average_in_basis, noise_spread)
        self._store = store
        self._schedule = schedule

    @property
    def dynamics(self) -> DynamicStatus:
        """Which landmarks move."""
        return self._averaging.dynamics

    @property
    def noise(self) -> NoiseEstimate:
        """How much observations deviate."""
        return self._averaging.noise

    def resize(self, n: int) -> None:
        """Make room for landmarks 0 to n - 1."""
        if n <= len(self.map.weights):
            return
        self.map.resize(n, self._store.dimension)
        self.levels.resize(n)
        self.dynamics.resize(n)

    def forget(self, segments: CondensedSegments) -> bool:
        """Condense and drop some observations that no later group needs; tell if there are any."""
        end = self._store.n_iterations
        oldest = self._schedule.oldest_needed
        before = max(end if oldest is None else oldest, end - LONGEST_INTERVAL)
        condensed = segments.condense(self._store, before, self.dynamics.dynamic)
        self._store.forget(min(before, segments.end))
        return condensed

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark go on in place of a new one, which turned out to be it."""
        self.map.merge(new, old)
        self.levels.merge(new, old)
        self.dynamics.merge(new, old)

    def last_pass(self, seed: int, fixes: int) -> NDArray[np.int64]:
        """Group a landmark that has left the view over its whole interval, at level 3.

        What little is left of an interval that was cut while it lasted needs no group of its own.

        Returns
        -------
        (n,) int64
            The landmarks placed.
        """
        placed = np.empty(0, dtype=np.int64)
        if self._needs_last_pass(np.array([seed]))[0]:
            placed = self.group(seed, 3, fixes)
        if self._schedule.is_gone[seed]:
            self._be_done_with(np.array([seed]))
        return placed

    def next_last_pass(self) -> int | None:
        """Return who needs its last pass next; None where nobody does yet.

        Those that need none are done with at once, so that they never make the others wait.
        """
        waited = self._schedule.waited(self._store.n_iterations)
        needed = self._needs_last_pass(waited)
        if not needed.all():
            self._be_done_with(waited[~needed])
        waited = waited[needed]
        # The group of the one seen longest is of use to most of the others.
        return int(waited[np.argmax(self._schedule.counts[waited])]) if len(waited) else None

    def _needs_last_pass(self, landmarks: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell whose interval holds enough for a group, does not move and is still stored; (n,)."""
        mapped = self.map.weights[landmarks] > 0
        enough = np.where(mapped, self._schedule.group_after, FEWEST)
        needed = self._schedule.counts[landmarks] >= enough
        needed &= self._schedule.last_seen(landmarks) >= self._store.first_iteration
        return np.asarray(needed & ~self.dynamics.dynamic[landmarks])

    def group(self, seed: int, level: int, fixes: int) -> NDArray[np.int64]:
        """Grow a group around a landmark and align it to the map.

        Parameters
        ----------
        seed : int
        level : int
            1, 2 or 3: which pass it is.
        fixes : int
            How few mapped landmarks fix a group.

        Returns
        -------
        (n,) int64
            The landmarks placed; none where it could not be.
        """
        chart = self._chart(seed)
        for piece in self.map.pieces_of(chart.landmarks, fixes):
            weights = self.map.weights_in(piece, chart.landmarks)
            averaged = self._average(chart, weights, fixes)
            if averaged is None:
                continue
            relative = averaged[0]
            placed = self.map.align(piece, relative.landmarks, relative.positions, relative.n_used)
            if placed is not None:
                return self._place(piece, level, placed, *averaged)
        return np.empty(0, dtype=np.int64)

    def found_piece(self, seed: int, level: int, fixes: int) -> None:
        """Begin the map, or a new piece of it where what is in view is not enough to go on.

        The frame is that of the robot in the first iteration of the group.
        """
        mapped_in_view = np.sum(self.map.weights[self._schedule.in_view] > 0)
        if mapped_in_view >= fixes or self.dynamics.dynamic[seed]:
            return
        chart = self._chart(seed)
        if not len(chart.iterations):
            return
        chart = chart.only(chart.visible[:, 0])
        averaged = self._average(chart, np.zeros(len(chart.landmarks)), fixes, 0)
        if averaged is None:
            return
        relative = averaged[0]
        first = chart.points_robot[np.isin(chart.landmarks, relative.landmarks), 0]
        if len(first) > fixes:
            R, t = fit_rigid(relative.positions, first)
            placed = relative.positions @ R.T + t
            self._place(self.map.new_piece(), level, placed, *averaged)

    def _chart(self, seed: int) -> PointChart:
        end = self._store.n_iterations
        begin = max(self._schedule.begin[seed], self._store.first_iteration)
        return PointChart.around(seed, self._store, begin, end)

    def _average(
        self,
        chart: PointChart,
        weights: NDArray[np.float64],
        fixes: int,
        min_shared: int | None = None,
    ) -> tuple[RelativeMap, NDArray[np.int64]] | None:
        """Average a chart; return the relative map and the common interval of its core."""
        min_shared = fixes if min_shared is None else min_shared
        averaged = self._averaging.average(chart, weights, fixes + 1, min_shared)
        moving = chart.landmarks[self.dynamics.dynamic[chart.landmarks]]
        if len(moving):
            self.map.remove(moving)
            self.levels.leave(moving)
            self._schedule.begin_anew(moving, self._store.n_iterations)
        if averaged is None:
            return None
        relative, core = averaged
        return relative, chart.iterations[core.columns]

    def _place(
        self,
        piece: int,
        level: int,
        placed: NDArray[np.float64],
        relative: RelativeMap,
        common_interval: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Enter a relative map, placed in the frame of a piece, where it is the best there is."""
        landmarks = relative.landmarks
        self.map.join(piece, landmarks, placed)
        # Of a landmark whose interval began within the chart, what came before is settled.
        begin = self._schedule.begin[landmarks][:, None]
        n_averaged = np.sum(relative.used & (relative.iterations >= begin), axis=1)
        reached = self._schedule.reached(landmarks, n_averaged, level)
        best = self.levels.better(landmarks, reached, n_averaged)
        members, reached, n_averaged = landmarks[best], reached[best], n_averaged[best]
        self.map.place(piece, members, placed[best], n_averaged.astype(np.float64))
        group = MappedGroup(
            landmarks=landmarks,
            relative_map=relative.positions,
            n_observations=relative.n_used,
            iterations=common_interval,
        )
        self.levels.take(group, members, reached, n_averaged)
        self._close(members[reached == 3])
        return landmarks[self.map.weights[landmarks] > 0]

    def _be_done_with(self, gone: NDArray[np.int64]) -> None:
        """Close the intervals of landmarks that have left, and judge those that got no place."""
        self.dynamics.judge_at_last(gone[self.map.weights[gone] == 0])
        self._close(gone)

    def _close(self, landmarks: NDArray[np.int64]) -> None:
        """End the interval of landmarks: where they are now is kept for good."""
        self.map.settle(landmarks)
        self.levels.close(landmarks)
        self._schedule.begin_anew(landmarks, self._store.n_iterations)
