"""One Gauss-Newton step of placements that lay landmarks somewhere, in slices of bounded cost."""

from __future__ import annotations

from collections.abc import Generator, Iterator

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import sums_each
from relmap.core.jointequations import rotations
from relmap.core.tridiagonal import Levels, factored

SLICE = 1500
"""Rows that are taken care of at a time."""
MOST_FLOPS = 3e7
"""What a slice of the solution may cost: a millisecond.  Where it would more, bodies are joined."""
Points = NDArray[np.float64]
Indices = NDArray[np.int64]


class StepInSlices:
    """One step for all placements, of which the first stays where it is.

    Parameters
    ----------
    placed : (n, d) float64, map frame, metres
        Where each placement puts a landmark.
    landmark : (n,) int64
    placement : (n,) int64, ascending
    weight : (n,) float64

    Attributes
    ----------
    moves : (m, d) float64, metres
        How far the landmarks move, after `run`.
    latest : (d, d) float64, (d,) float64 and (d,) float64
        Turn, shift and centre of the last placement, after `run`.
    """

    def __init__(
        self, placed: Points, landmark: Indices, placement: Indices, weight: Points
    ) -> None:
        self._placed, self._landmark = placed, landmark
        self._placement, self._weight = placement, weight
        self._m = int(landmark.max()) + 1
        self._d = placed.shape[1]
        self._entry = np.empty(0, dtype=np.int64)
        self._begin = np.empty(0, dtype=np.int64)
        self.moves = np.zeros((self._m, self._d))
        self.latest = np.eye(self._d), np.zeros(self._d), np.zeros(self._d)

    def run(self) -> Iterator[None]:
        """Solve for where the placements go, and move the landmarks along, slice by slice."""
        self._entry = np.argsort(self._landmark, kind="stable")
        counts = np.bincount(self._landmark, minlength=self._m)
        self._begin = np.concatenate([[0], np.cumsum(counts)])
        yield
        means = self._mean(self._placed)
        yield
        levels = self._levels()
        centre = self._centres()
        if len(centre) == 1:
            return
        yield
        right, matrix = yield from self._equations(levels, centre, means)
        levels.hold(matrix)
        levels.fix(matrix, 0)
        right[0] = 0.0
        factor = yield from factored(levels, matrix)
        step = factor.solve(right)
        yield
        turns, shifts = rotations(step[:, : -self._d]), step[:, -self._d :]
        self.latest = turns[-1], shifts[-1], centre[-1]
        at = self._placement
        moved = np.einsum("nij,nj->ni", turns[at], self._placed - centre[at])
        moved += centre[at] + shifts[at]
        yield
        self.moves = self._mean(moved) - means

    def _levels(self) -> Levels:
        """Return levels of the placements, neighbours joined until none costs too much."""
        from relmap.core.kernels.joint import breadth_first

        while True:
            p = int(self._placement[-1]) + 1
            begin = np.searchsorted(self._placement, np.arange(p + 1))
            of = self._placement[self._entry]
            level = breadth_first(0, begin, self._landmark, self._begin, of)[1]
            levels = Levels(level, 3 * self._d - 3)
            if levels.most_flops <= MOST_FLOPS or p == 1:
                return levels
            self._placement = self._placement // 2

    def _equations(
        self, levels: Levels, centre: Points, means: Points
    ) -> Generator[None, None, tuple[Points, Points]]:
        """Return right side and matrix, the landmarks eliminated, some of them at a time."""
        from relmap.core.kernels.joint import placement_equations

        centred = self._placed - centre[self._placement]
        residual = self._placed - means[self._landmark]
        gradient, buffer = np.zeros((len(centre), levels.q)), np.zeros(levels.size)
        yield
        first = 0
        while first < self._m:
            end = int(np.searchsorted(self._begin, self._begin[first] + SLICE, side="right"))
            end = min(max(end - 1, first + 1), self._m)
            placement_equations(
                self._begin[first : end + 1],
                self._entry,
                self._placement,
                centred,
                residual,
                self._weight,
                gradient,
                buffer,
                *levels.layout,
            )
            first = end
            yield
        return -gradient, buffer

    def _centres(self) -> Points:
        """Return the middle (p, d) of each placement."""
        p = int(self._placement[-1]) + 1
        counts = np.bincount(self._placement, minlength=p)
        return np.asarray(sums_each(self._placed, self._placement, p) / counts[:, None])

    def _mean(self, values: Points) -> Points:
        """Return the weighted mean (m, d) of values (n, d) for each landmark."""
        total = np.bincount(self._landmark, weights=self._weight, minlength=self._m)
        sums = sums_each(values * self._weight[:, None], self._landmark, self._m)
        return np.asarray(sums / total[:, None])
