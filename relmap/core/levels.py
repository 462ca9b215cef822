"""Which group each landmark's position comes from, and at which level (section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.growing import GrowingArray
from relmap.core.landmarks import MappedGroup

NONE = -1
"""In place of a group: no group has placed the landmark in its present interval."""


class GroupLevels:
    """The highest-level group of every landmark's interval; lower ones that nobody needs are gone.

    A landmark's position is that of its highest-level group, and of equal levels of the one that
    averaged more of its observations.
    """

    def __init__(self) -> None:
        self._levels: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._highest: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._averaged: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._group_of: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._groups: dict[int, MappedGroup] = {}
        self._users: dict[int, int] = {}
        self._n_groups = 0

    @property
    def present(self) -> NDArray[np.int64]:
        """Level that each landmark has reached in its present interval, 0 to 3; (n,)."""
        return self._levels.values

    @property
    def highest(self) -> NDArray[np.int64]:
        """Level that each landmark has reached in any interval; (n,)."""
        return self._highest.values

    @property
    def groups(self) -> list[MappedGroup]:
        """The groups that some landmark's position comes from, in the order of their making."""
        return list(self._groups.values())

    def resize(self, n: int) -> None:
        """Make room for landmarks 0 to n - 1."""
        for column in (self._levels, self._highest, self._averaged):
            column.resize(n, 0)
        self._group_of.resize(n, NONE)

    def better(
        self,
        landmarks: NDArray[np.int64],
        reached: NDArray[np.int64],
        n_averaged: NDArray[np.int64],
    ) -> NDArray[np.bool_]:
        """Tell whose best position a group holds that lets them reach levels (n,)."""
        before = self.present[landmarks]
        more = n_averaged > self._averaged.values[landmarks]
        return np.asarray(more & (reached >= before) | (reached > before) & (n_averaged > 0))

    def take(
        self,
        group: MappedGroup,
        members: NDArray[np.int64],
        reached: NDArray[np.int64],
        n_averaged: NDArray[np.int64],
    ) -> None:
        """Let members (k,) have their positions from a group; drop groups that nobody needs now."""
        self._release(members)
        if len(members):
            self._groups[self._n_groups] = group
            self._users[self._n_groups] = len(members)
        self._group_of.values[members] = self._n_groups
        self._n_groups += 1
        self._levels.values[members] = reached
        self._highest.values[members] = np.maximum(self.highest[members], reached)
        self._averaged.values[members] = n_averaged

    def leave(self, landmarks: NDArray[np.int64]) -> None:
        """Take landmarks that turned out to move out of their groups."""
        self._release(landmarks)
        self._highest.values[landmarks] = 0
        self.close(landmarks)

    def close(self, landmarks: NDArray[np.int64]) -> None:
        """End the interval of landmarks: their positions in it stay with their groups."""
        self._group_of.values[landmarks] = NONE
        self._levels.values[landmarks] = 0
        self._averaged.values[landmarks] = 0

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark go on in place of a new one, which turned out to be it."""
        for column in (self._levels, self._averaged, self._group_of):
            column.values[old] = column.values[new]
        self._highest.values[old] = max(self.highest[old], self.highest[new])

    def _release(self, landmarks: NDArray[np.int64]) -> None:
        groups, users = np.unique(self._group_of.values[landmarks], return_counts=True)
        for group, n in zip(groups.tolist(), users.tolist(), strict=True):
            if group != NONE:
                self._users[group] -= n
                if self._users[group] == 0:
                    del self._groups[group], self._users[group]
