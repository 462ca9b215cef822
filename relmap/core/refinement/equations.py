"""Joint least squares over segments, eliminating either placements or landmarks.

With placements eliminated the system grows with the map, but not with the duration of the run; with
landmarks eliminated its size does not depend on the number of landmarks seen at once. Both are
needed: for the figure eight at density 100, 900 iterations, refinement takes 0.18 s the first way
and 0.05 s the second, at 0.7 % more error; at density 200, 0.93 s and 0.09 s.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid_each, place_each, sums_each
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.condensing import LENGTH
from relmap.core.refinement.rows import JointRows
from relmap.core.refinement.schur import Elimination, Linearised, NormalEquations

FLOPS_PER_OBSERVATION, FLOPS = 1.1e4, 8e8
"""Budget of operations of a step with one placement per iteration, per observation, and in all for
small maps. Beyond it segments are placed as a whole, which is up to 1.4 times less accurate where
the view changes quickly."""
HOLD = 1e-9, 1e-6
"""Damping of an unknown, as a fraction of its diagonal entry and in observations, so that poorly
determined unknowns do not move far."""
STIFF = 1e9
"""Damping of a fixed unknown, relative to the largest diagonal entry."""
BARELY = 1e-13
"""Regularisation against rounding, as a fraction of the entries of a matrix. A larger value would
bias the covariances: many weak priors along a chain add up."""
ROUNDING = 1e-13
"""Residual treated as rounding, as a fraction of the map's size."""


class SegmentState(NamedTuple):
    """Landmarks (m, d), and the rows (k, d) of each placement, placed, metres."""

    positions: Floats
    placed: Floats


class SegmentProblem:
    """The residuals of the rows of segments; a `Problem`.

    `size`: size of the map, metres. `members` (row, placement, times), (k,) each: the rows of each
    placement, and how many times it is this one; by default a placement for each segment.

    Attributes: `unknown` (m, d): unknowns of the landmarks; None if they are eliminated.
    """

    pattern: Pattern
    unknown: Ints | None = None

    def __init__(
        self, rows: JointRows, size: float, members: tuple[Ints, Ints, Floats] | None = None
    ) -> None:
        self.rows = rows
        n, d = rows.points.shape
        self._members = (np.arange(n), rows.segment, rows.n_seen) if members is None else members
        unknowns = d * len(rows.landmarks) + (3 * d - 3) * (len(rows.segments) - 1)
        self.freedoms = max(d * n - unknowns, 1)
        self.rounding = n * (ROUNDING * size) ** 2

    def of_segments(self, state: SegmentState) -> SegmentState:
        """Return the state for rows (n, d) of segments that are placed as a whole."""
        return SegmentState(state.positions, state.placed[self._members[0]])

    def fitted(self, positions: Floats, weight: Floats) -> SegmentState:
        """Place the rows where they fit the positions best, given weights (n,) of the rows."""
        row, at, times = self._members
        points, n = self.rows.points[row], int(at[-1]) + 1
        R, t, _ = fit_rigid_each(points, self._there(positions), weight[row] * times, at, n)
        return SegmentState(positions, place_each(R, t, at, points))

    def residuals(self, state: SegmentState) -> Floats:
        """Return the lengths (n,) of the residuals, normalised to one observation."""
        row, _, times = self._members
        squares = times * np.sum((state.placed - self._there(state.positions)) ** 2, axis=1)
        return np.asarray(np.sqrt(np.bincount(row, squares, minlength=len(self.rows.points))))

    def _there(self, positions: Floats) -> Floats:
        """Return the position (k, d) of the landmark of each placed row."""
        return np.asarray(positions[self.rows.landmark[self._members[0]]])

    def equations(
        self,
        state: SegmentState,
        weight: Floats,
        with_matrix: bool,
        damping: float,
        hold: tuple[float, float] = HOLD,
    ) -> NormalEquations:
        """Return the normal equations of the kept unknowns."""
        equations = self._reduced(state, weight, with_matrix)
        share, least = hold
        if len(equations.matrix):
            least += share * self.pattern.largest(equations.matrix)
            self.pattern.hold(equations.matrix, share + damping, least)
            self._fix(equations.matrix)
        return equations

    def _reduced(self, state: SegmentState, weight: Floats, with_matrix: bool) -> NormalEquations:
        raise NotImplementedError

    def _fix(self, matrix: Floats) -> None:
        """Fix the unknowns that define the frame."""

    def stepped(
        self, state: SegmentState, equations: NormalEquations, step: Floats, weight: Floats
    ) -> SegmentState:
        """Return the state after a step."""
        return self.fitted(self._moved(state, step, weight), weight)

    def covariances(self, state: SegmentState, weight: Floats) -> Floats:
        """Return the covariances (m, d, d) of the landmarks under noise of variance 1."""
        return self._covariances(state, weight, self.pattern.inverse(self.factor(state, weight)))

    def factor(self, state: SegmentState, weight: Floats) -> Floats:
        """Return the Cholesky factor of the matrix at the optimum."""
        matrix = self.equations(state, weight, True, 0.0, (BARELY, 0.0)).matrix
        self.pattern.factorise(matrix)
        return matrix

    def _moved(self, state: SegmentState, step: Floats, weight: Floats) -> Floats:
        raise NotImplementedError

    def _covariances(self, state: SegmentState, weight: Floats, inverse: Floats) -> Floats:
        raise NotImplementedError

    def _away(self, placed: Floats) -> Floats:
        """Return placed rows (k, d) from the centre of their placement."""
        at = self._members[1]
        sizes = np.bincount(at)
        return np.asarray(placed - (sums_each(placed, at, len(sizes)) / sizes[:, None])[at])


class FreePlacements(SegmentProblem):
    """Keeps the landmarks; the placement of each iteration is eliminated.

    At the optimum a segment placed as a whole would fit less well, by some percent if few landmarks
    are seen throughout.

    `pattern`: pattern of the landmarks; `anchor` (segment, bit): the iteration whose placement is
    fixed.
    """

    unknown: Ints

    def __init__(
        self, rows: JointRows, size: float, pattern: Pattern, anchor: tuple[int, int]
    ) -> None:
        seen, sizes, times, segment, fixed = self._placements(rows, anchor)
        at = np.repeat(np.arange(len(sizes)), sizes)
        super().__init__(rows, size, (seen, at, times[at]))
        d = self._d = rows.points.shape[1]
        self.pattern = pattern
        self.unknown = pattern.first[:, None] + np.arange(d)
        begin = np.append(0, np.cumsum(d * sizes))
        kept = self.unknown[rows.landmark[seen]].reshape(-1, 1)
        every = np.arange(begin[-1])
        self._eliminated = Elimination(
            pattern, kept, begin, every, segment, times, free_in_matrix=times - fixed
        )

    @staticmethod
    def _placements(
        rows: JointRows, anchor: tuple[int, int]
    ) -> tuple[Ints, Ints, Floats, Ints, Floats]:
        """Return the rows seen by placements, each distinct set once.

        With each set: the number of its rows, of the placements that saw it, its segment, and how
        many of the placements are the anchor.
        """
        bits = (rows.visible >> np.arange(LENGTH)[:, None]) & 1 > 0
        begin, seen, times, segment, fixed = rows.begin, [], [], [], []
        for s, (first, end) in enumerate(pairwise(begin)):
            own = bits[:, first:end]
            for saw, count in Counter(bit.tobytes() for bit in own if bit.any()).items():
                seen.append(first + np.flatnonzero(np.frombuffer(saw, dtype=bool)))
                times.append(float(count))
                segment.append(s)
                fixed.append(s == anchor[0] and saw == own[anchor[1]].tobytes())
        sizes = np.array([len(rows) for rows in seen])
        counts = np.array(times), np.array(segment), np.array(fixed, dtype=np.float64)
        return np.concatenate(seen), sizes, *counts

    def _reduced(self, state: SegmentState, weight: Floats, with_matrix: bool) -> NormalEquations:
        there = self._there(state.positions)
        turns = derivatives(self._away(there))
        off, ones = (state.placed - there).ravel(), np.ones((there.size, 1))
        linear = Linearised(off, turns.reshape(len(off), -1), -ones)
        each = np.repeat(weight[self._members[0]], self._d)
        return self._eliminated.equations(linear, each, BARELY, with_matrix)

    def _moved(self, state: SegmentState, step: Floats, weight: Floats) -> Floats:
        return np.asarray(state.positions + step[self.unknown])

    def _covariances(self, state: SegmentState, weight: Floats, inverse: Floats) -> Floats:
        return self.pattern.parts(inverse, self.unknown)


class FreeLandmarks(SegmentProblem):
    """Keeps one placement per segment; the landmarks are eliminated.

    The anchor iteration, which defines the frame, has a separate, fixed placement.

    `anchor` (segment, bit): that iteration.
    """

    def __init__(self, rows: JointRows, size: float, anchor: tuple[int, int]) -> None:
        super().__init__(rows, size)
        d = self._d = rows.points.shape[1]
        self._anchor, bit = anchor
        own = np.flatnonzero(rows.segment == self._anchor)
        own = own[(rows.visible[own] >> bit) & 1 > 0]
        self._row = np.concatenate([np.arange(len(rows.points)), own])
        self._seen = np.concatenate([rows.n_seen, np.ones(len(own))])
        self._seen[own] -= 1
        own_segment = np.full(len(own), len(rows.segments))
        self._placement = np.concatenate([rows.segment, own_segment])
        self._fixed = len(rows.segments)
        width = np.full(self._fixed + 1, 3 * d - 3)
        self.pattern = Pattern.of_pairs(width, rows.landmark[self._row], self._placement)
        self._unknown = self.pattern.first[:, None] + np.arange(3 * d - 3)
        begin = np.append(0, np.cumsum(np.bincount(rows.landmark[self._row])))
        entry = np.argsort(rows.landmark[self._row], kind="stable")
        scalar = (d * entry[:, None] + np.arange(d)).ravel()
        kept = np.repeat(self._unknown[self._placement], d, axis=0)
        every = np.arange(len(rows.landmarks))
        self._eliminated = Elimination(self.pattern, kept, d * begin, scalar, every)

    def _reduced(self, state: SegmentState, weight: Floats, with_matrix: bool) -> NormalEquations:
        linear, each = self._linearised(state, weight)
        equations = self._eliminated.equations(linear, each, BARELY, with_matrix)
        right, fixed = equations.right, self._unknown[self._fixed]
        # The anchor only defines the frame: its observations act on its segment.
        right[self._unknown[self._anchor]] += right[fixed]
        right[fixed] = 0.0
        return equations

    def _fix(self, matrix: Floats) -> None:
        stiff = STIFF * max(self.pattern.largest(matrix), 1.0)
        self.pattern.add_diagonal(matrix, self._unknown[self._fixed], stiff)

    def _linearised(self, state: SegmentState, weight: Floats) -> tuple[Linearised, Floats]:
        """Return the residuals of the rows, some of them twice, and their weights."""
        rows, d = self.rows, self._d
        off = (state.placed - state.positions[rows.landmark])[self._row]
        turns = derivatives(self._away(state.placed)[self._row]).reshape(off.size, -1)
        by_landmark = np.tile(-np.eye(d), (len(off), 1))
        return (
            Linearised(off.ravel(), by_landmark, turns),
            np.repeat(self._seen * weight[self._row], d),
        )

    def _moved(self, state: SegmentState, step: Floats, weight: Floats) -> Floats:
        """Return the means of the rows after transforming their segments."""
        steps, d = step[self._unknown], self._d
        steps[self._fixed] = steps[self._anchor]
        turn, shift = rotations(steps[:, :-d]), steps[:, -d:]
        placed, away = state.placed[self._row], self._away(state.placed)[self._row]
        moved = place_each(turn, shift, self._placement, away) + (placed - away)
        return self.means(moved, weight)

    def means(self, placed: Floats, weight: Floats) -> Floats:
        """Return the weighted mean (m, d) for each landmark of placed rows (k, d)."""
        omega, of = self._seen * weight[self._row], self.rows.landmark[self._row]
        m = len(self.rows.landmarks)
        total = np.bincount(of, weights=omega, minlength=m)
        return np.asarray(sums_each(placed * omega[:, None], of, m) / total[:, None])

    def _covariances(self, state: SegmentState, weight: Floats, inverse: Floats) -> Floats:
        linear, each = self._linearised(state, weight)
        return self._eliminated.covariances(linear, each, BARELY, inverse)


def segment_problem(
    rows: JointRows, size: float, anchor: tuple[int, int]
) -> FreePlacements | FreeLandmarks:
    """Return the exact problem, or that of whole segments if the exact one is too expensive.

    `size`: size of the map, metres; `anchor` (segment, bit): the iteration whose placement defines
    the frame.
    """
    flops, budget = exact_flops(rows), max(FLOPS, FLOPS_PER_OBSERVATION * rows.n_seen.sum())
    width = np.full(len(rows.landmarks), rows.points.shape[1])
    if flops <= budget:
        pattern = Pattern.of_pairs(width, rows.segment, rows.landmark)
        flops += pattern.flops
    if flops > budget:
        coarse = FreeLandmarks(rows, size, anchor)
        if flops > coarse.pattern.flops:
            return coarse
        pattern = Pattern.of_pairs(width, rows.segment, rows.landmark)
    return FreePlacements(rows, size, pattern, anchor)


def exact_flops(rows: JointRows) -> float:
    """Return the approximate number of operations to eliminate all placements."""
    d = rows.points.shape[1]
    sizes = d * np.diff(rows.begin).astype(np.float64)
    return float(2 * LENGTH * (3 * d - 3) * np.sum(sizes**2))
