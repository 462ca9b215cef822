"""The group and the level that each landmark's position comes from (section III)."""

from __future__ import annotations

from collections import Counter

import numpy as np

from relmap.core.arrays import Bools, Ints
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

    def better(self, landmarks: Ints, reached: Ints, n_averaged: Ints) -> Bools:
        """Return whose best position a group provides, given the levels (n,) that it reaches."""
        before = self._table.level[landmarks]
        more = n_averaged > self._table.averaged[landmarks]
        return np.asarray(more & (reached >= before) | (reached > before) & (n_averaged > 0))

    def take(self, group: MappedGroup, members: Ints, reached: Ints, n_averaged: Ints) -> None:
        """Take the positions of members (k,) from a group; drop groups no longer needed."""
        self._release(members)
        if len(members):
            self._groups[self.n_groups] = group
            self._users[self.n_groups] = len(members)
        self._table.group[members] = self.n_groups
        self.n_groups += 1
        self._table.level[members] = reached
        self._table.highest_level[members] = np.maximum(self._table.highest_level[members], reached)
        self._table.averaged[members] = n_averaged

    def leave(self, landmarks: Ints) -> None:
        """Remove landmarks that turned out to move from their groups."""
        self._release(landmarks)
        self._table.highest_level[landmarks] = 0
        self.close(landmarks)

    def close(self, landmarks: Ints) -> None:
        """End the interval of landmarks: their positions in it stay with their groups."""
        self._table.group[landmarks] = NONE
        self._table.level[landmarks] = 0
        self._table.averaged[landmarks] = 0

    def _release(self, landmarks: Ints) -> None:
        for group, n in Counter(self._table.group[landmarks].tolist()).items():
            if group != NONE:
                self._users[group] -= n
                if self._users[group] == 0:
                    del self._groups[group], self._users[group]
