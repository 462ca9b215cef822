"""Adding a group's relative map to the global map."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.grouping.completion import RelativeMap
from relmap.core.grouping.dynamics import FEWEST, judge_at_last
from relmap.core.grouping.levels import GroupLevels
from relmap.core.landmarks import MappedGroup
from relmap.core.map.globalmap import GlobalMap
from relmap.core.state.schedule import GroupingSchedule
from relmap.core.state.store import ObservationStore


class Placing:
    """Adds groups to the map, and ends the intervals of landmarks that left the view."""

    def __init__(
        self,
        store: ObservationStore,
        schedule: GroupingSchedule,
        global_map: GlobalMap,
        levels: GroupLevels,
    ) -> None:
        self._table = global_map.table
        self._store = store
        self._schedule = schedule
        self._map = global_map
        self._levels = levels

    def place(self, submap: int, level: int, placed: Floats, relative: RelativeMap) -> Ints:
        """Add a relative map for the landmarks for which it is the best group.

        `level`: the pass: 1, 2 or 3; `placed` (n, d), frame of the submap, metres: the relative
        map, aligned. Returns (k,): the newly mapped landmarks.
        """
        landmarks = relative.landmarks
        self._map.join(submap, landmarks, placed)
        # For a landmark whose interval began within the chart, the earlier positions are settled.
        begin = self._table.begin[landmarks][:, None]
        n_averaged = np.sum(relative.used & (relative.iterations >= begin), axis=1)
        reached = self._schedule.reached(landmarks, n_averaged, level)
        best = self._levels.better(landmarks, reached, n_averaged)
        members, reached, n_averaged = landmarks[best], reached[best], n_averaged[best]
        self._map.place(submap, members, placed[best], n_averaged.astype(np.float64))
        group = MappedGroup(
            landmarks=landmarks,
            relative_map=relative.positions,
            n_observations=relative.n_used,
            iterations=relative.common_interval,
        )
        self._levels.take(group, members, reached, n_averaged)
        if (reached == 3).any():
            self._close(members[reached == 3])
        return landmarks[self._table.weight[landmarks] > 0]

    def leave_out_moving(self, landmarks: Ints) -> None:
        """Remove those of landmarks (k,) that are dynamic from the map."""
        moving = landmarks[self._table.dynamic[landmarks]]
        if len(moving):
            self._table.take_off_map(moving)
            self._levels.leave(moving)
            self._schedule.begin_anew(moving, self._store.n_iterations)

    def next_last_pass(self) -> int | None:
        """Return the next landmark that needs its last pass; None if there is none yet.

        Landmarks that need none are closed at once, so that they do not delay the others.
        """
        waited = self._schedule.waited(self._store.n_iterations)
        if not len(waited):
            return None
        needed = self.needs_last_pass(waited)
        if not needed.all():
            self.be_done_with(waited[~needed])
        waited = waited[needed]
        # The group of the landmark seen longest serves most of the others.
        return int(waited[np.argmax(self._table.in_interval[waited])]) if len(waited) else None

    def needs_last_pass(self, landmarks: Ints) -> Bools:
        """Return which landmarks are static and have enough stored observations for a group; (n,).

        A short remainder of an interval that was split needs no separate group.
        """
        mapped = self._table.weight[landmarks] > 0
        enough = np.where(mapped, self._schedule.group_after, FEWEST)
        needed = self._table.in_interval[landmarks] >= enough
        needed &= self._table.last[landmarks] >= self._store.first_iteration
        return np.asarray(needed & ~self._table.dynamic[landmarks])

    def be_done_with(self, gone: Ints) -> None:
        """Close the intervals of landmarks that have left, and classify those never placed."""
        judge_at_last(self._table, gone[self._table.weight[gone] == 0])
        self._close(gone)

    def _close(self, landmarks: Ints) -> None:
        """End the interval of landmarks: their current positions are settled."""
        self._table.settle(landmarks)
        self._levels.close(landmarks)
        self._schedule.begin_anew(landmarks, self._store.n_iterations)
