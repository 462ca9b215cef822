"""The joint least squares over segments of points, with one side eliminated or the other.

Placements eliminated leave equations that grow with the map, but not with the time spent in it;
landmarks eliminated leave equations that do not mind how many landmarks are seen at once.  Both are
needed: of the figure eight at density 100, 900 iterations, refining takes 0.18 s the first way and
0.05 s the second, for 0.7 % of error; at density 200 0.93 and 0.09 s.  The live steps are of the
second kind.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid_each, place_each, sums_each
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.condensing import LENGTH
from relmap.core.refinement.rows import JointRows, levels_of, rows_of_each
from relmap.core.refinement.schur import Elimination, Linearised, NormalEquations

FLOPS_PER_OBSERVATION, FLOPS = 2e4, 2e9
"""What may be spent to have one placement for each iteration: half a microsecond or so each, and
half a second in all to begin with segments as a whole.  These are up to 1.4 times worse where much
comes into view from scan to scan."""
HOLD = 1e-9, 1e-6
"""What holds an unknown in a step, as a share of what holds others and in observations: none moves
far that hangs by nothing."""
BARELY = 1e-13
"""What keeps rounding from making a matrix indefinite, as a share of its entries.  More belongs in
no covariance: many weak holds along a chain add up to a strong one."""
ROUNDING = 1e-13
"""Residual that is taken for rounding, as a share of the map's size."""


class Laid(NamedTuple):
    """Landmarks (m, d), and the rows (n, d) of each segment where it was laid on them, metres."""

    positions: Floats
    placed: Floats


class SegmentProblem:
    """The residuals of the rows of segments; a `Problem`.

    Parameters
    ----------
    rows : JointRows
    size : float
        Of the map, metres.
    """

    pattern: Pattern

    def __init__(self, rows: JointRows, size: float) -> None:
        self.rows = rows
        n, d = rows.points.shape
        unknowns = d * len(rows.landmarks) + (3 * d - 3) * (len(rows.segments) - 1)
        self.freedoms = max(d * n - unknowns, 1)
        self.rounding = n * (ROUNDING * size) ** 2

    def laid(self, positions: Floats, weight: Floats) -> Laid:
        """Lay each segment on positions as it fits best, by observations of weights (n,)."""
        rows, there = self.rows, positions[self.rows.landmark]
        R, t, _ = fit_rigid_each(
            rows.points, there, weight * rows.n_seen, rows.segment, len(rows.segments)
        )
        return Laid(positions, place_each(R, t, rows.segment, rows.points))

    def residuals(self, state: Laid) -> Floats:
        """Return the lengths (n,) of what is left, in units of an observation."""
        off = state.placed - state.positions[self.rows.landmark]
        return np.asarray(np.sqrt(np.sum(off**2, axis=1) * self.rows.n_seen))

    def equations(
        self,
        state: Laid,
        weight: Floats,
        with_matrix: bool,
        damping: float,
        hold: tuple[float, float] = HOLD,
    ) -> NormalEquations:
        """Return the normal equations of what is kept."""
        raise NotImplementedError

    def stepped(
        self, state: Laid, equations: NormalEquations, step: Floats, weight: Floats
    ) -> Laid:
        """Return where landmarks and segments lie after a step."""
        return self.laid(self._moved(state, step, weight), weight)

    def covariances(self, state: Laid, weight: Floats) -> Floats:
        """Return the covariances (m, d, d) of the landmarks under noise of variance 1."""
        matrix = self.equations(state, weight, True, 0.0, (BARELY, 0.0)).matrix
        self.pattern.factorise(matrix)
        return self._covariances(state, weight, self.pattern.inverse(matrix))

    def _moved(self, state: Laid, step: Floats, weight: Floats) -> Floats:
        raise NotImplementedError

    def _covariances(self, state: Laid, weight: Floats, inverse: Floats) -> Floats:
        raise NotImplementedError

    def _held(self, equations: NormalEquations, damping: float, hold: tuple[float, float]) -> None:
        share, least = hold
        if len(equations.matrix):
            least += share * self.pattern.largest(equations.matrix)
            self.pattern.hold(equations.matrix, share + damping, least)

    def _centre(self, placed: Floats) -> Floats:
        """Return the middle (s, d) of each segment."""
        total = sums_each(placed, self.rows.segment, len(self.rows.segments))
        return np.asarray(total / np.diff(self.rows.begin)[:, None])


class FreePlacements(SegmentProblem):
    """The landmarks are kept; each iteration has a placement of its own, and is eliminated.

    Parameters
    ----------
    rows : JointRows
    size : float
    pattern : Pattern
        Of the landmarks.
    anchor : (segment, bit)
        The iteration whose placement is not free.
    """

    def __init__(
        self, rows: JointRows, size: float, pattern: Pattern, anchor: tuple[int, int]
    ) -> None:
        super().__init__(rows, size)
        d = self._d = rows.points.shape[1]
        self.pattern = pattern
        self._unknown = pattern.first[:, None] + np.arange(d)
        seen, sizes, times, segment, fixed = self._placements(anchor)
        begin = np.append(0, np.cumsum(d * sizes))
        scalar = (d * seen[:, None] + np.arange(d)).ravel()
        kept = self._unknown[rows.landmark].reshape(-1, 1)
        self._eliminated = Elimination(
            pattern, kept, begin, scalar, segment, times, free_in_matrix=times - fixed
        )

    def _placements(self, anchor: tuple[int, int]) -> tuple[Ints, Ints, Floats, Ints, Floats]:
        """Return the rows that placements saw, each set once.

        How many rows each saw, how many placements saw them, in which segment, and how many of them
        are the anchor.
        """
        bits = (self.rows.visible >> np.arange(LENGTH)[:, None]) & 1 > 0
        begin, seen, times, segment, fixed = self.rows.begin, [], [], [], []
        for s, (first, end) in enumerate(pairwise(begin)):
            own = bits[:, first:end]
            for saw, count in Counter(row.tobytes() for row in own if row.any()).items():
                seen.append(first + np.flatnonzero(np.frombuffer(saw, dtype=bool)))
                times.append(float(count))
                segment.append(s)
                fixed.append(s == anchor[0] and saw == own[anchor[1]].tobytes())
        sizes = np.array([len(rows) for rows in seen])
        counts = np.array(times), np.array(segment), np.array(fixed, dtype=np.float64)
        return np.concatenate(seen), sizes, *counts

    def equations(
        self,
        state: Laid,
        weight: Floats,
        with_matrix: bool,
        damping: float,
        hold: tuple[float, float] = HOLD,
    ) -> NormalEquations:
        """Return the normal equations of the landmarks."""
        rows, d = self.rows, self._d
        there = state.positions[rows.landmark]
        turns = derivatives(there - self._centre(there)[rows.segment])
        off, ones = (state.placed - there).ravel(), np.ones((d * len(there), 1))
        linear = Linearised(off, turns.reshape(len(off), -1), -ones)
        equations = self._eliminated.equations(linear, np.repeat(weight, d), BARELY, with_matrix)
        self._held(equations, damping, hold)
        return equations

    def _moved(self, state: Laid, step: Floats, weight: Floats) -> Floats:
        return np.asarray(state.positions + step[self._unknown])

    def _covariances(self, state: Laid, weight: Floats, inverse: Floats) -> Floats:
        return self.pattern.parts(inverse, self._unknown)


class FreeLandmarks(SegmentProblem):
    """Each segment has one placement and is kept; the landmarks are eliminated.

    The iteration that makes the frame has a placement of its own, that is not free.

    Parameters
    ----------
    rows : JointRows
    size : float
    level : (s,) int64
        Of each segment.
    anchor : (segment, bit), optional
        The first segment as a whole, where left out.
    """

    def __init__(
        self, rows: JointRows, size: float, level: Ints, anchor: tuple[int, int] | None = None
    ) -> None:
        super().__init__(rows, size)
        d = self._d = rows.points.shape[1]
        segment, bit = (0, None) if anchor is None else anchor
        self._anchor = segment
        own = np.flatnonzero(rows.segment == segment)
        own = own[:0] if bit is None else own[(rows.visible[own] >> bit) & 1 > 0]
        self._row = np.concatenate([np.arange(len(rows.points)), own])
        self._seen = np.concatenate([rows.n_seen, np.ones(len(own))])
        self._seen[own] -= 1
        own_segment = np.full(len(own), len(rows.segments))
        self._placement = np.concatenate([rows.segment, own_segment])
        levels = level if bit is None else np.append(level, level[segment])
        self._fixed = len(levels) - 1 if bit is not None else segment
        self.pattern = Pattern.of_levels(levels, 3 * d - 3)
        self._unknown = self.pattern.first[:, None] + np.arange(3 * d - 3)
        begin, entry = rows_of_each(rows.landmark[self._row], len(rows.landmarks))
        scalar = (d * entry[:, None] + np.arange(d)).ravel()
        kept = np.repeat(self._unknown[self._placement], d, axis=0)
        every = np.arange(len(rows.landmarks))
        self._eliminated = Elimination(self.pattern, kept, d * begin, scalar, every)

    def equations(
        self,
        state: Laid,
        weight: Floats,
        with_matrix: bool,
        damping: float,
        hold: tuple[float, float] = HOLD,
    ) -> NormalEquations:
        """Return the normal equations of the placements."""
        linear, each = self._linearised(state, weight)
        equations = self._eliminated.equations(linear, each, BARELY, with_matrix)
        right, fixed = equations.right, self._unknown[self._fixed]
        # The anchor only makes the frame: what pulls at it pulls at its segment.
        if self._fixed != self._anchor:
            right[self._unknown[self._anchor]] += right[fixed]
        right[fixed] = 0.0
        self._held(equations, damping, hold)
        if with_matrix:
            self.pattern.fix(equations.matrix, self._fixed, len(fixed))
        return equations

    def _linearised(self, state: Laid, weight: Floats) -> tuple[Linearised, Floats]:
        """Return the residuals of the rows, some of them twice, and their weights."""
        rows, d = self.rows, self._d
        off = (state.placed - state.positions[rows.landmark])[self._row]
        away = state.placed - self._centre(state.placed)[rows.segment]
        turns = derivatives(away[self._row]).reshape(off.size, -1)
        by_landmark = np.tile(-np.eye(d), (len(off), 1))
        return (
            Linearised(off.ravel(), by_landmark, turns),
            np.repeat(self._seen * weight[self._row], d),
        )

    def _moved(self, state: Laid, step: Floats, weight: Floats) -> Floats:
        """Return the means of the rows, their segments turned and shifted."""
        steps, d = step[self._unknown], self._d
        if self._fixed != self._anchor:
            steps[self._fixed] = steps[self._anchor]
        turn, shift = rotations(steps[:, :-d]), steps[:, -d:]
        centre = self._centre(state.placed)[self.rows.segment][self._row]
        away = state.placed[self._row] - centre
        moved = place_each(turn, shift, self._placement, away) + centre
        return self.means(moved, weight)

    def means(self, placed: Floats, weight: Floats) -> Floats:
        """Return the weighted mean (m, d) for each landmark of what was laid somewhere (k, d)."""
        omega, of = self._seen * weight[self._row], self.rows.landmark[self._row]
        m = len(self.rows.landmarks)
        total = np.bincount(of, weights=omega, minlength=m)
        return np.asarray(sums_each(placed * omega[:, None], of, m) / total[:, None])

    def _covariances(self, state: Laid, weight: Floats, inverse: Floats) -> Floats:
        linear, each = self._linearised(state, weight)
        return self._eliminated.covariances(linear, each, BARELY, inverse)


def segment_problems(
    rows: JointRows, size: float, anchor: tuple[int, int]
) -> list[FreePlacements | FreeLandmarks]:
    """Return what is to be solved, one after the other: the exact problem in the end.

    Where that takes long, that of segments as a whole goes before, and where it takes too long, in
    its stead.

    Parameters
    ----------
    rows : JointRows
    size : float
        Of the map, metres.
    anchor : (segment, bit)
        The iteration whose placement makes the frame.
    """
    d = rows.points.shape[1]
    levels = levels_of(rows.begin, rows.landmark, len(rows.landmarks))
    pattern = Pattern.of_levels(levels[0], d)
    flops = exact_flops(rows, pattern)
    problems: list[FreePlacements | FreeLandmarks] = []
    if flops > FLOPS_PER_OBSERVATION * rows.n_seen.sum():
        coarse = FreeLandmarks(rows, size, levels[1], anchor)
        problems += [coarse] if flops > coarse.pattern.flops else []
    if not problems or flops <= FLOPS:
        problems.append(FreePlacements(rows, size, pattern, anchor))
    return problems


def exact_flops(rows: JointRows, pattern: Pattern) -> float:
    """Return about how many operations it takes to eliminate all placements, and to solve."""
    d = rows.points.shape[1]
    sizes = d * np.diff(rows.begin).astype(np.float64)
    return float(pattern.flops + 2 * LENGTH * (3 * d - 3) * np.sum(sizes**2))


def derivatives(away: Floats) -> Floats:
    """Return the derivatives (n, d, q) of points by a turn and a shift; (n, d) from the centre."""
    n, d = away.shape
    J = np.zeros((n, d, 3 * d - 3))
    J[:, :, -d:] = np.eye(d)
    if d == 2:
        J[:, 0, 0], J[:, 1, 0] = -away[:, 1], away[:, 0]
    else:
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            J[:, a, b], J[:, a, c] = away[:, c], -away[:, b]
    return J


def rotations(turns: Floats) -> Floats:
    """Return the rotations (n, d, d) by angles (n, 1) or rotation vectors (n, 3)."""
    if turns.shape[1] == 3:
        return np.asarray(Rotation.from_rotvec(turns).as_matrix())
    cos, sin = np.cos(turns[:, 0]), np.sin(turns[:, 0])
    return np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)
