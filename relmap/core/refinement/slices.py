"""One Gauss-Newton step of placements that lay landmarks somewhere, in slices of bounded cost."""

from __future__ import annotations

from collections.abc import Generator, Iterator

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.cholesky import Pattern, level_flops
from relmap.core.refinement.equations import held, rotations
from relmap.core.refinement.rows import searched
from relmap.core.state.growing import FEW, GrowingArray

SLICE = 1500
"""Rows that are taken care of at a time."""
LIGHT = 6
"""Times as many where little is done with each."""
MOST_FLOPS = 3e7
"""What a slice of the solution may cost: a millisecond.  Where it would more, bodies are joined."""
LOOSE = 1e-9
"""What holds a placement that hangs by too little, as a share of others and in observations."""
BODIES = 1000
"""Placements at most.  Of a longer run, consecutive ones are joined to one rigid body."""
Points = NDArray[np.float64]
Indices = NDArray[np.int64]


class StepInSlices:
    """One step for all placements, of which the first stays where it is.

    Rows are added in the order of their placements; then `run` takes the step.

    Parameters
    ----------
    n_rows, n_landmarks, n_placements : int
        That may be added, at most.
    dimension : int

    Attributes
    ----------
    moves : (m, d) float64, metres
        How far the `members` (m,) move, after `run`.
    latest : (d, d) float64, (d,) float64 and (d,) float64
        Turn, shift and centre of the last placement, after `run`.
    """

    STATE = (
        "_d _rows _placed _weight _landmark _placement _number _members _counts _total _sums "
        "_p _middle"
    )

    def __init__(self, n_rows: int, n_landmarks: int, n_placements: int, dimension: int) -> None:
        d, self._q = dimension, 3 * dimension - 3
        self._d = d
        self._rows = 0
        self._placed = np.zeros((n_rows, d))
        self._weight = np.zeros(n_rows)
        self._landmark = np.zeros(n_rows, dtype=np.int64)
        self._placement = np.zeros(n_rows, dtype=np.int64)
        self._number = np.full(n_landmarks, -1)
        self._members: GrowingArray[np.int64] = GrowingArray(np.int64, room=FEW)
        self._counts = np.zeros(n_landmarks, dtype=np.int64)
        self._total = np.zeros(n_landmarks)
        self._sums = np.zeros((n_landmarks, d))
        self._p = 0
        self._middle = np.zeros((n_placements, d + 1))
        self._body, self._bodies = self._placement, self._middle
        self.moves = np.zeros((0, d))
        self.latest = np.eye(d), np.zeros(d), np.zeros(d)

    @property
    def n_landmarks(self) -> int:
        """Beyond the numbers of the landmarks that rows may be of."""
        return len(self._number)

    @property
    def members(self) -> Indices:
        """The landmarks that were added, in the order of that; (m,)."""
        return self._members.values

    def add(self, placed: Points, landmark: Indices, placement: Indices, weight: Points) -> None:
        """Add the rows of some placements.

        Parameters
        ----------
        placed : (n, d) float64, map frame, metres
            Where each placement puts a landmark.
        landmark : (n,) int64
        placement : (n,) int64, ascending, none of them added before
        weight : (n,) float64
        """
        rows = slice(self._rows, self._rows + len(placed))
        new = np.unique(landmark[self._number[landmark] < 0])
        m = len(self._members)
        self._number[new] = np.arange(m, m + len(new))
        self._members.extend(new)
        own, at = np.unique(placement, return_inverse=True)
        self._placed[rows], self._weight[rows] = placed, weight
        self._landmark[rows], self._placement[rows] = self._number[landmark], self._p + at
        np.add.at(self._counts, self._landmark[rows], 1)
        np.add.at(self._total, self._landmark[rows], weight)
        _add_at(self._sums, self._landmark[rows], weight[:, None] * placed)
        _add_at(self._middle, self._placement[rows], np.column_stack([placed, np.ones(len(at))]))
        self._rows, self._p = rows.stop, self._p + len(own)

    def run(self) -> Iterator[None]:
        """Solve for where the placements go, and move the landmarks along, slice by slice.

        What was added stays as it is, so that a run cut short can be run again.
        """
        if self._p < 2:
            self.moves = np.zeros((len(self.members), self._d))
            return
        self._body, self._bodies = self._placement[: self._rows], self._middle[: self._p]
        self._join(int(np.ceil(np.log2(max(self._p / BODIES, 1)))))
        begin = np.concatenate([[0], np.cumsum(self._counts[: len(self.members)])])
        yield
        entry = yield from self._entries(begin)
        means = self._sums[: len(self.members)] / self._total[: len(self.members), None]
        level = yield from self._levels(begin, entry)
        pattern = Pattern.of_levels(level, self._q)
        right, matrix = yield from self._equations(begin, entry, pattern, means)
        held(pattern, matrix, LOOSE, LOOSE)
        pattern.fix(matrix, 0, self._q)
        right[0] = 0.0
        yield from pattern.factorised(matrix, MOST_FLOPS)
        step = pattern.solve(matrix, right)
        yield
        turns, shifts = rotations(step[:, : -self._d]), step[:, -self._d :]
        self.latest = turns[-1], shifts[-1], self._centre[-1]
        self.moves = (yield from self._moved(turns, shifts)) - means

    @property
    def _centre(self) -> Points:
        """The middle (b, d) of each body."""
        return np.asarray(self._bodies[:, :-1] / self._bodies[:, -1:])

    def _slices(self) -> Iterator[slice]:
        for first in range(0, self._rows, LIGHT * SLICE):
            yield slice(first, min(first + LIGHT * SLICE, self._rows))

    def _join(self, times: int) -> None:
        """Join neighbouring bodies in twos, some times."""
        self._body = self._body >> times
        self._bodies = np.add.reduceat(self._bodies, np.arange(0, len(self._bodies), 1 << times))

    def _entries(self, begin: Indices) -> Generator[None, None, Indices]:
        """Return the rows (n,) in the order of their landmarks."""
        entry, filled = np.empty(self._rows, dtype=np.int64), begin[:-1].copy()
        for rows in self._slices():
            order = np.argsort(self._landmark[rows], kind="stable")
            landmark = self._landmark[rows][order]
            earlier = np.arange(len(order)) - np.searchsorted(landmark, landmark)
            entry[filled[landmark] + earlier] = rows.start + order
            np.add.at(filled, landmark, 1)
            yield
        return entry

    def _moved(self, turns: Points, shifts: Points) -> Generator[None, None, Points]:
        """Return the weighted mean (m, d) of each landmark, its placements turned and shifted."""
        sums, centre = np.zeros((len(self.members), self._d)), self._centre
        for rows in self._slices():
            at = self._body[rows]
            away = self._placed[rows] - centre[at]
            moved = np.einsum("nij,nj->ni", turns[at], away) + centre[at] + shifts[at]
            _add_at(sums, self._landmark[rows], self._weight[rows, None] * moved)
            yield
        return np.asarray(sums / self._total[: len(sums), None])

    def _levels(self, begin: Indices, entry: Indices) -> Generator[None, None, Indices]:
        """Return levels (b,) of the bodies, neighbours joined until none costs too much."""
        while True:
            of_rows = np.searchsorted(self._body, np.arange(len(self._bodies) + 1))
            landmark, body = self._landmark[: self._rows], self._body
            search = searched(0, of_rows, landmark, (begin, entry), body, LIGHT * SLICE)
            level = (yield from search)[1]
            most = float(level_flops(level, self._q).max())
            if most <= MOST_FLOPS or len(self._bodies) == 1:
                return level
            self._join(max(1, int(np.log2(most / MOST_FLOPS) / 3)))

    def _equations(
        self, begin: Indices, entry: Indices, pattern: Pattern, means: Points
    ) -> Generator[None, None, tuple[Points, Points]]:
        """Return right side and matrix, the landmarks eliminated, some of them at a time."""
        from relmap.core.refinement.joint_kernels import placement_equations

        centred, residual = np.empty((2, self._rows, self._d))
        centre = self._centre
        for rows in self._slices():
            centred[rows] = self._placed[rows] - centre[self._body[rows]]
            residual[rows] = self._placed[rows] - means[self._landmark[rows]]
            yield
        gradient, buffer = np.zeros((len(self._bodies), self._q)), np.zeros(pattern.size)
        first = 0
        while first < len(means):
            end = int(np.searchsorted(begin, begin[first] + SLICE, side="right"))
            end = min(max(end - 1, first + 1), len(means))
            entries = begin[first : end + 1], entry, self._body
            rows_of = centred, residual, self._weight
            placement_equations(*entries, *rows_of, gradient, buffer, pattern.blocks)
            first = end
            yield
        return -gradient, buffer


def _add_at(sums: Points, at: Indices, values: Points) -> None:
    """Add values (n, k) to rows of sums (m, k)."""
    for column, of in zip(sums.T, values.T, strict=True):
        np.add.at(column, at, of)
