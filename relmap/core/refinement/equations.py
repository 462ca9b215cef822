"""The normal equations of the joint least squares, with one side eliminated or the other.

Two sets of unknowns are coupled, landmarks and placements, and one of them is eliminated (Schur
complement; Triggs et al., "Bundle adjustment - a modern synthesis", 2000).  Landmarks that stay
make equations that grow with the map, but not with the time spent in it; placements that stay make
equations that do not mind how many landmarks are seen at once. Both are needed: of
the figure eight at density 100, 900 iterations take 0.25 s the first way and 0.07 s the second, for
0.9 % of error; after 9000 the second takes 4 times as many operations as the first (4e10), and at
density 400 the first takes 2000 times as many as the second (1e11).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from relmap.core.geometry.alignment import sums_each
from relmap.core.linalg.cholesky import Pattern
from relmap.core.refinement.condensing import LENGTH
from relmap.core.refinement.elimination import FreePlacements
from relmap.core.refinement.rows import JointRows, at_once, rows_of_each, searched

ALL = 2**62
"""More rows than there are."""
FLOPS_PER_OBSERVATION = 2e4
"""What may be spent to have one placement for each iteration: half a microsecond or so."""


class Equations(Protocol):
    """Normal equations with one side eliminated.

    Attributes
    ----------
    pattern : Pattern
        Where the unknowns that stay stand.
    cost : (s,) float64
        Weighted sum of squares that each segment left, when the equations were last made.
    """

    pattern: Pattern
    cost: NDArray[np.float64]

    def normal(
        self,
        positions: NDArray[np.float64],
        placed: NDArray[np.float64],
        weight: NDArray[np.float64],
        hold: tuple[float, float] | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return right side and matrix; an empty one where it is not asked for.

        Parameters
        ----------
        positions : (m, d) float64, map frame, metres
        placed : (n, d) float64, map frame, metres
            The rows, each segment where it fits the positions best.
        weight : (n,) float64
            Of one observation in a row.
        hold : (share, least), optional
            What holds unknowns that nothing else does, see `hold`; no matrix without it.
        """
        ...

    def moved(
        self,
        positions: NDArray[np.float64],
        placed: NDArray[np.float64],
        weight: NDArray[np.float64],
        step: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the positions after a step, the solution of the equations."""
        ...

    def covariances(
        self, inverse: NDArray[np.float64], placed: NDArray[np.float64], weight: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the covariances (m, d, d) of the landmarks under noise of variance 1.

        From the inverse of the matrix, where `pattern` has entries.
        """
        ...


def equations(rows: JointRows, anchor: tuple[int, int]) -> Equations:
    """Return the exact equations, or where these take too long those of segments as a whole.

    Parameters
    ----------
    rows : JointRows
    anchor : (segment, bit)
        The iteration whose placement makes the frame.
    """
    levels = levels_of(rows.begin, rows.landmark, len(rows.landmarks))
    exact = LandmarkEquations(rows, anchor, levels[0])
    coarse = PlacementEquations(rows, anchor, levels[1])
    affordable = FLOPS_PER_OBSERVATION * rows.n_seen.sum()
    return exact if exact.flops <= max(affordable, coarse.pattern.flops) else coarse


def held(pattern: Pattern, matrix: NDArray[np.float64], share: float, least: float) -> None:
    """Give unknowns that hang by too little, or by nothing, a little hold where they are.

    It damps a step, and belongs in no covariance but for `BARELY`: many weak holds along a chain
    add up to a strong one.
    """
    pattern.hold(matrix, share, least + share * pattern.largest(matrix))


def levels_of(
    begin: NDArray[np.int64], landmark: NDArray[np.int64], n_landmarks: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return levels of landmarks and of what saw them, beginning at an outer landmark.

    Parameters
    ----------
    begin : (s + 1,) int64
        Where the rows of each segment, or iteration, begin.
    landmark : (n,) int64
        Of each row, 0 to `n_landmarks` - 1.
    n_landmarks : int
    """
    by_landmark = rows_of_each(landmark, n_landmarks)
    segment = np.repeat(np.arange(len(begin) - 1), np.diff(begin))
    outer = 0
    for _ in range(2):
        levels = at_once(searched(outer, begin, landmark, by_landmark, segment, ALL))
        outer = int(np.argmax(levels[0]))
    return levels


class LandmarkEquations:
    """The landmarks stay; each iteration has a placement of its own, and is eliminated."""

    def __init__(self, rows: JointRows, anchor: tuple[int, int], level: NDArray[np.int64]) -> None:
        d = self._d = rows.points.shape[1]
        self._sizes = d * np.diff(rows.begin).astype(np.float64)
        self._free = FreePlacements(rows, anchor)
        self.cost = np.zeros(len(rows.segments))
        self.pattern = Pattern.of_levels(level, d)

    @property
    def flops(self) -> float:
        """About how many operations the equations and their solution take."""
        d = self._d
        return float(self.pattern.flops + 2 * LENGTH * (3 * d - 3) * np.sum(self._sizes**2))

    def normal(
        self,
        positions: NDArray[np.float64],
        placed: NDArray[np.float64],
        weight: NDArray[np.float64],
        hold: tuple[float, float] | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return right side and matrix; see `Equations`."""
        buffer = np.zeros(self.pattern.size if hold else 0)
        right, self.cost = self._free.equations(positions, placed, weight, self.pattern, buffer)
        if hold:
            held(self.pattern, buffer, *hold)
        return right, buffer

    def moved(
        self,
        positions: NDArray[np.float64],
        placed: NDArray[np.float64],
        weight: NDArray[np.float64],
        step: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the positions after a step; see `Equations`."""
        return positions + step

    def covariances(
        self, inverse: NDArray[np.float64], placed: NDArray[np.float64], weight: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the covariances of the landmarks; see `Equations`."""
        return self.pattern.diagonal(inverse, self._d)


class PlacementEquations:
    """One placement for each segment stays, and one for the anchor; landmarks are eliminated."""

    def __init__(self, rows: JointRows, anchor: tuple[int, int], level: NDArray[np.int64]) -> None:
        d = rows.points.shape[1]
        self._rows = rows
        self._anchor = anchor
        self.cost = np.zeros(len(rows.segments))
        # The rows that the anchor saw come twice: what it saw itself, and what the others did.
        self._own = np.flatnonzero(
            (rows.segment == anchor[0]) & ((rows.visible >> anchor[1]) & 1 > 0)
        )
        n = len(rows.points)
        self._row = np.concatenate([np.arange(n), self._own])
        self._seen = np.concatenate([rows.n_seen, np.ones(len(self._own), dtype=np.int64)])
        self._seen[self._own] -= 1
        self._placement = np.concatenate(
            [rows.segment, np.full(len(self._own), len(rows.segments))]
        )
        landmark = rows.landmark[self._row]
        self._entry_begin, self._entry = rows_of_each(landmark, len(rows.landmarks))
        self.pattern = Pattern.of_levels(np.append(level, level[anchor[0]]), 3 * d - 3)

    def normal(
        self,
        positions: NDArray[np.float64],
        placed: NDArray[np.float64],
        weight: NDArray[np.float64],
        hold: tuple[float, float] | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return right side and matrix; see `Equations`."""
        from relmap.core.refinement.joint_kernels import placement_equations

        pattern, omega = self.pattern, self._seen * weight[self._row]
        gradient = np.zeros((len(pattern.first), 3 * placed.shape[1] - 3))
        buffer = np.zeros(pattern.size if hold else 0)
        residual = (placed - self._means(placed, weight)[self._rows.landmark])[self._row]
        squares = omega * np.sum(residual**2, axis=1)
        self.cost = np.bincount(self._rows.segment[self._row], weights=squares).astype(np.float64)
        placement_equations(
            self._entry_begin,
            self._entry,
            self._placement,
            self._centred(placed),
            residual,
            omega,
            gradient,
            buffer,
            pattern.blocks,
        )
        fixed = len(pattern.first) - 1
        # The anchor only makes the frame: what pulls at it pulls at its segment.
        gradient[self._anchor[0]] += gradient[fixed]
        gradient[fixed] = 0.0
        if hold:
            held(pattern, buffer, *hold)
            pattern.fix(buffer, fixed, gradient.shape[1])
        return -gradient, buffer

    def moved(
        self,
        positions: NDArray[np.float64],
        placed: NDArray[np.float64],
        weight: NDArray[np.float64],
        step: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the positions after a step; see `Equations`."""
        d = placed.shape[1]
        step[-1] = step[self._anchor[0]]
        turn, shift = rotations(step[:, :-d]), step[:, -d:]
        centred, centre = self._centred(placed), self._centres(placed)[self._placement]
        moved = np.einsum("nij,nj->ni", turn[self._placement], centred) + centre
        return self._weighted_means(moved + shift[self._placement], weight)

    def covariances(
        self, inverse: NDArray[np.float64], placed: NDArray[np.float64], weight: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the covariances of the landmarks; see `Equations`."""
        from relmap.core.refinement.joint_kernels import spread_of_landmarks

        return spread_of_landmarks(
            self._entry_begin,
            self._entry,
            self._placement,
            self._centred(placed),
            self._seen * weight[self._row],
            inverse,
            self.pattern.blocks,
        )

    def _means(
        self, placed: NDArray[np.float64], weight: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        return self._weighted_means(placed[self._row], weight)

    def _weighted_means(
        self, values: NDArray[np.float64], weight: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the mean (m, d) of values (k, d) for each landmark."""
        omega, of = self._seen * weight[self._row], self._rows.landmark[self._row]
        m = len(self._rows.landmarks)
        total = np.bincount(of, weights=omega, minlength=m)
        return np.asarray(sums_each(values * omega[:, None], of, m) / total[:, None])

    def _centres(self, placed: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the middle (p, d) of each placement's segment."""
        s = len(self._rows.segments)
        counts = np.bincount(self._rows.segment, minlength=s)
        middle = sums_each(placed, self._rows.segment, s) / counts[:, None]
        return np.vstack([middle, middle[self._anchor[0]]])

    def _centred(self, placed: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(placed[self._row] - self._centres(placed)[self._placement])


def rotations(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotations (n, d, d) by angles (n, 1) or rotation vectors (n, 3)."""
    if turns.shape[1] == 3:
        return np.asarray(Rotation.from_rotvec(turns).as_matrix())
    cos, sin = np.cos(turns[:, 0]), np.sin(turns[:, 0])
    return np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)
