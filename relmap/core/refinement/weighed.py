"""Refinement by single observations, weighted by their given covariances.

Observations with different, anisotropic noise cannot be summarised by segments. So they are kept,
and the map refined by segments is the initial estimate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.geometry.motions import derivatives
from relmap.core.refinement.equations import BARELY, ROUNDING
from relmap.core.refinement.joint import Refined, Spread
from relmap.core.refinement.observations import Observations, observations_of
from relmap.core.refinement.powers import LOOSE, LOOSE_POSE, Placed
from relmap.core.refinement.rows import pattern_of
from relmap.core.refinement.schur import Elimination, Linearised, NormalEquations
from relmap.core.refinement.settling import settle, size_of
from relmap.core.state.weighed import WeighedObservations


def refine_weighed(refined: Refined, weighed: WeighedObservations, of: Ints) -> Refined:
    """Return the landmark positions by observations weighted with their covariances.

    `refined`: the map refined by segments; `of` (k,): the landmark that each number stands for,
    after merging.
    """
    seen, rows = observations_of(
        weighed.location,
        of[weighed.landmark],
        weighed.iteration,
        refined.landmarks,
        refined.positions,
    )
    anchor = int(np.searchsorted(seen.iterations, refined.anchor_iteration))
    counts = np.bincount(seen.landmark, minlength=len(refined.landmarks))
    if anchor == len(seen.iterations) or not counts.all():
        return refined
    problem = WeighedProblem(seen, weighed.covariance[rows], refined.positions, anchor)
    settled = settle(problem, problem.start(refined.positions))
    state = settled.state
    explained = (settled.weight == 1).astype(np.float64)
    R, t = state.R[anchor], state.t[anchor]
    unit = np.sqrt(explained @ problem.residuals(state) ** 2 / problem.freedoms_of(explained))
    every = np.ones(len(refined.landmarks), dtype=bool)
    return replace(
        refined,
        positions=(state.positions - t) @ R,
        spread=Spread(problem, settled, every, unit * R),
        converged=settled.converged,
    )


class WeighedProblem:
    """Residuals of single observations in standard deviations; a `Problem`.

    `covariance` (n, d, d), robot frame, square metres; `positions` (m, d), metres: approximate
    positions of the landmarks; `anchor`: the iteration whose pose defines the frame.
    """

    def __init__(
        self, seen: Observations, covariance: Floats, positions: Floats, anchor: int
    ) -> None:
        n, d = seen.points.shape
        m, k = len(positions), len(seen.iterations)
        self.seen, self._root = seen, np.linalg.inv(np.linalg.cholesky(covariance))
        self._fixed = d * m + (3 * d - 3) * (k - 1)
        self.freedoms = max(n * d - self._fixed, 1)
        self.rounding = float(np.sum(self._root**2)) * (ROUNDING * size_of(positions)) ** 2
        self.pattern = pattern_of(seen.iteration, seen.landmark, d)
        self._unknown = self.pattern.first[:, None] + np.arange(d)
        kept = np.repeat(self._unknown[seen.landmark], d, axis=0)
        free_in_matrix = (np.arange(k) != anchor).astype(np.float64)
        self._eliminated = Elimination(
            self.pattern,
            kept,
            d * seen.begin,
            np.arange(n * d),
            np.arange(k),
            free_in_matrix=free_in_matrix,
        )

    def start(self, positions: Floats) -> Placed:
        """Return the state with an approximate pose of each iteration for landmarks (m, d)."""
        weight, seen = np.sum(self._root**2, axis=(1, 2)), self.seen
        there = positions[seen.landmark]
        R, t, _ = fit_rigid_each(seen.points, there, weight, seen.iteration, len(seen.iterations))
        return Placed(positions, R, t)

    def freedoms_of(self, explained: Floats) -> float:
        """Return the degrees of freedom of the observations (n,) with weight 1."""
        return float(max(explained.sum() * self.seen.points.shape[1] - self._fixed, 1))

    def residuals(self, state: Placed) -> Floats:
        """Return the norms (n,) of the residuals, in standard deviations."""
        return np.asarray(np.linalg.norm(self._left(state)[0], axis=1))

    def equations(
        self, state: Placed, weight: Floats, with_matrix: bool, damping: float
    ) -> NormalEquations:
        """Return the normal equations of the landmarks."""
        equations = self._equations(state, weight, with_matrix, LOOSE_POSE)
        if with_matrix:
            least = LOOSE * self.pattern.largest(equations.matrix)
            self.pattern.hold(equations.matrix, damping, least)
        return equations

    def stepped(
        self, state: Placed, equations: NormalEquations, step: Floats, weight: Floats
    ) -> Placed:
        """Return the state after a step."""
        return state.moved(step[self._unknown], equations.eliminated_steps(step))

    def covariances(self, state: Placed, weight: Floats) -> Floats:
        """Return the covariances (m, d, d) of the landmarks, trusting the given ones."""
        matrix = self._equations(state, weight, True, BARELY).matrix
        self.pattern.hold(matrix, BARELY, 0.0)
        self.pattern.factorise(matrix)
        return self.pattern.parts(self.pattern.inverse(matrix), self._unknown)

    def _equations(
        self, state: Placed, weight: Floats, with_matrix: bool, hold: float
    ) -> NormalEquations:
        n, d = self.seen.points.shape
        left, by_landmark, away = self._left(state)
        by_placement = -(by_landmark @ derivatives(away)).reshape(n * d, -1)
        linear = Linearised(left.ravel(), by_placement, by_landmark.reshape(n * d, d))
        return self._eliminated.equations(linear, np.repeat(weight, d), hold, with_matrix)

    def _left(self, state: Placed) -> tuple[Floats, Floats, Floats]:
        """Return residuals (n, d), their Jacobians (n, d, d) by the landmark, and rays.

        The first two in standard deviations; the rays (n, d) from robot to landmark, map frame.
        """
        at = self.seen.iteration
        away = state.positions[self.seen.landmark] - state.t[at]
        back = np.swapaxes(state.R[at], 1, 2)
        off = self.seen.points - np.einsum("nij,nj->ni", back, away)
        left = np.einsum("nij,nj->ni", self._root, off)
        return left, -(self._root @ back), away
