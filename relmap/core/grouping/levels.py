"""The group and the level that each landmark's position comes from (section III)."""

from __future__ import annotations

from collections import Counter

from relmap.core.arrays import Counts, Floats, Ints
from relmap.core.grouping.completion import RelativeMap
from relmap.core.landmarks import MappedGroup
from relmap.core.state.table import NONE, LandmarkState


class GroupLevels:
    """Keeps the highest-level group of every interval of a landmark; drops unneeded groups.

    A landmark's position comes from its highest-level group; ties go to the group that averaged
    more of its observations.
    """

    _groups: dict[int, MappedGroup]
    _users: dict[int, int]
    STATE = "n_groups _users mapped=_groups"

    def __init__(self, table: LandmarkState) -> None:
        self._table = table
        self._groups = {}
        self._users = {}
        self.n_groups = 0  # created in total

    @property
    def groups(self) -> list[MappedGroup]:
        """The groups that provide some landmark's position, in order of creation."""
        return list(self._groups.values())

    def take(
        self, relative: RelativeMap, submap: int, placed: Floats, limits: tuple[int, float, int]
    ) -> Ints:
        """Take the positions of those landmarks (n,) for which a relative map is the best group.

        They are averaged with the settled ones, and groups that are no longer needed are dropped.

        `placed` (n, d), frame of the submap, metres; `limits`: the pass, and those of the schedule.
        Returns the landmarks (k,) that are complete.
        """
        import relmap.core.grouping.level_kernels as kernels

        of, seen = self._table, (relative.used, relative.iterations)
        interval = of.begin, of.in_interval, of.is_gone
        columns = of.submap, of.group, of.level, of.highest_level, of.averaged, *interval
        places = of.position, of.weight, of.settled_position, of.settled_weight
        whole, before = kernels.take(
            columns, places, submap, self.n_groups, relative.landmarks, placed, seen, limits
        )
        self._release(before)
        if len(before):
            self._groups[self.n_groups] = MappedGroup(
                landmarks=relative.landmarks,
                relative_map=relative.positions,
                n_observations=relative.n_used,
                iterations=relative.common_interval,
            )
            self._users[self.n_groups] = len(before)
        self.n_groups += 1
        return whole

    def leave(self, landmarks: Ints) -> None:
        """Remove landmarks that turned out to move from their groups."""
        self._release(self._table.group[landmarks])
        self._table.highest_level[landmarks] = 0
        self.close(landmarks)

    def close(self, landmarks: Ints) -> None:
        """End the interval of landmarks: their positions in it stay with their groups."""
        self._table.group[landmarks] = NONE
        self._table.level[landmarks] = 0
        self._table.averaged[landmarks] = 0

    def _release(self, groups: Ints | Counts) -> None:
        for group, n in Counter(groups.tolist()).items():
            if group != NONE:
                self._users[group] -= n
                if self._users[group] == 0:
                    del self._groups[group], self._users[group]
