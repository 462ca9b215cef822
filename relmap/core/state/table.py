"""The landmark table: one row per landmark.

The parts of the engine are functions of its columns, or thin views on them (see `columns`); none
keeps separate per-landmark arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints, entries
from relmap.core.state.columns import COLUMNS, MERGED, NONE, Columns

__all__ = ["NONE", "LandmarkState"]

ROWS = 2**11
"""Approximate initial capacity of the columns."""

AHEAD = 64
"""Rows initialised at a time."""


class LandmarkState(Columns):
    """One row per landmark, in order of first observation.

    Row `k` keeps the number `k`. A landmark merged into an older one continues in that one's row,
    given by `landmark_of`.
    """

    STATE = " ".join(COLUMNS)

    def __init__(self) -> None:
        self._rooms: dict[str, NDArray[Any]] = {}
        self._merged_into: dict[int, list[int]] = {}
        self._begin(0)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.landmark_of)

    def __getstate__(self) -> dict[str, Any]:
        """Copy the rows, not the spare capacity."""
        rooms = {name: getattr(self, name).copy() for name in COLUMNS}
        return {"_rooms": rooms, "_merged_into": self._merged_into}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the rows of another table."""
        self.__dict__.update(state)
        self._filled = len(self._rooms["landmark_of"])
        self._show(len(self._rooms["landmark_of"]))

    def restored(self) -> None:
        """Make the current columns the buffers."""
        self._rooms = {name: getattr(self, name) for name in COLUMNS}
        self._filled = len(self)
        if len({len(room) for room in self._rooms.values()}) > 1:
            raise ValueError("the columns of the landmarks are of different lengths")
        for row in np.flatnonzero(~self.is_own).tolist():
            self._merged_into.setdefault(int(self.landmark_of[row]), []).append(row)

    @property
    def dimension(self) -> int:
        """Number of coordinates of a position; 0 before any observation."""
        return int(self.position.shape[1])

    @property
    def submaps(self) -> list[int]:
        """Numbers of the submaps, the largest first."""
        numbers, sizes = np.unique(self.submap[self.submap != NONE], return_counts=True)
        by_size: list[int] = numbers[np.argsort(-sizes, kind="stable")].tolist()
        return by_size

    @property
    def is_own(self) -> Bools:
        """Whether each row is still a landmark, not merged into another; (n,)."""
        return np.asarray(self.landmark_of == np.arange(len(self)))

    def resize(self, n: int, iteration: int, dimension: int) -> None:
        """Add rows up to `n` for landmarks first seen in this iteration.

        `dimension`: number of coordinates of a position.
        """
        before = len(self)
        if n <= before:
            return
        if before == 0:
            self._begin(dimension)
        if n > self._filled:
            self._fill(n + AHEAD)
        self._show(n)
        for column in (self.track_begin, self.first, self.since):
            column[before:] = iteration

    def enter(self, landmarks: Ints, points: Floats, iteration: int) -> Ints:
        """Add rows for the new ones of landmarks (k,) seen now at points (k, d).

        Returns the landmarks after merging.
        """
        import relmap.core.state.seeing_kernels as kernels

        n = int(landmarks[landmarks.argmax()]) + 1 if len(landmarks) else 0
        self.resize(n, iteration, points.shape[1])
        columns = self.landmark_of, self.track_end, self.track_observations
        return kernels.enter(columns, landmarks, iteration)

    def now(self, landmarks: Ints) -> Ints:
        """Return the landmarks (any shape) after merging, given their numbers; -1 stays."""
        if not self._merged_into:
            return landmarks.copy()
        return entries(self.landmark_of, landmarks)

    def settle(self, landmarks: Ints) -> None:
        """Settle the positions of landmarks (k,): later positions are averaged with them."""
        mapped = landmarks[self.weight[landmarks] > 0]
        self.settled_position[mapped] = self.position[mapped]
        self.settled_weight[mapped] = self.weight[mapped]

    def take_off_map(self, landmarks: Ints) -> None:
        """Unmap landmarks (k,)."""
        self.position[landmarks] = np.nan
        self.weight[landmarks] = self.settled_weight[landmarks] = 0.0
        self.submap[landmarks] = NONE

    def merge(self, new: Ints, old: Ints) -> None:
        """Merge new landmarks (k,) into the older ones (k,) that they are, all of them distinct.

        The position is the average of both; the part from the current interval is still replaced by
        better groups.
        """
        for one, other in zip(new.tolist(), old.tolist(), strict=True):
            rows = [one, *self._merged_into.pop(one, [])]
            self.landmark_of[rows] = other
            self._merged_into.setdefault(other, []).extend(rows)
        self.settle(old)
        _average(self.position, self.weight, new, old)
        _average(self.settled_position, self.settled_weight, new, old)
        self.take_off_map(new)
        later = self.last[new] > self.last[old]
        self.since[old[later]] = self.since[new[later]]
        for name, column in COLUMNS.items():
            if column.merged != "old":
                values = getattr(self, name)
                values[old] = MERGED[column.merged](values[new], values[old])
        self.is_gone[new] = False

    def members(self, landmark: int) -> list[int]:
        """Return the numbers that represent a landmark, its own first, the others ascending."""
        return [landmark, *sorted(self._merged_into.get(landmark, []))]

    def part(self, track: int) -> None:
        """Make a track that was merged into a landmark a separate landmark again, unmapped."""
        landmark = int(self.landmark_of[track])
        self._merged_into[landmark].remove(track)
        self.landmark_of[track] = track
        for row in (landmark, track):
            begin, end = self._stretches(row)
            latest = end.argmax()
            self.first[row] = begin.min()
            self.since[row], self.last[row] = begin[latest], end[latest]
        self.observations[track] = self.track_observations[track]
        self.observations[landmark] -= self.track_observations[track]

    def is_later(self, new: int, old: int) -> bool:
        """Return whether one landmark was first seen after another was last, without overlap."""
        if self.last[old] < self.first[new]:
            return True
        alone = new not in self._merged_into and old not in self._merged_into
        if self.last[old] >= self.last[new] or alone:
            return False
        begin, end = self._stretches(new)
        other_begin, other_end = self._stretches(old)
        before = begin[:, None] <= other_end
        return not bool((before & (other_begin <= end[:, None])).any())

    def _stretches(self, landmark: int) -> tuple[Ints, Ints]:
        """Return the first and last iterations of each track of a landmark."""
        numbers = self.members(landmark)
        return self.track_begin[numbers], self.track_end[numbers]

    def _begin(self, dimension: int) -> None:
        self._filled = 0
        # Different sizes, so that no two columns are full in the same iteration.
        for k, (name, column) in enumerate(COLUMNS.items()):
            shape = (ROWS + k * ROWS // len(COLUMNS), *([dimension] if column.vector else []))
            self._rooms[name] = np.empty(shape, column.dtype)
        self._show(0)

    def _fill(self, n: int) -> None:
        """Initialise rows up to `n` for new landmarks, some in advance."""
        for name, column in COLUMNS.items():
            if n > len(self._rooms[name]):
                before = self._rooms[name]
                size = max(n, 2 * len(before)), *before.shape[1:]
                self._rooms[name] = np.empty(size, before.dtype)
                self._rooms[name][: self._filled] = before[: self._filled]
            self._rooms[name][self._filled : n] = column.fill
        self._rooms["landmark_of"][self._filled : n] = np.arange(self._filled, n)
        self._filled = n

    def _show(self, n: int) -> None:
        columns, rows = self.__dict__, slice(n)
        for name, room in self._rooms.items():
            columns[name] = room[rows]


def _average(positions: Floats, weights: Floats, new: Ints, old: Ints) -> None:
    """Average the positions of mapped landmarks (k,) into those of others (k,)."""
    new, old = new[weights[new] > 0], old[weights[new] > 0]
    theirs, own = weights[new, None], weights[old, None]
    positions[old] = (theirs * positions[new] + own * positions[old]) / (theirs + own)
    weights[old] += weights[new]
