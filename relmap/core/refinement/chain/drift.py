"""Uncertainty of the landmarks along a chain of poses, relative to one of the poses."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import derivatives
from relmap.core.refinement.chain.chain_data import Chained
from relmap.core.refinement.chain.chained import ChainProblem
from relmap.core.refinement.gauss_newton import Solution

EXPLAINED = 4.0
"""Largest square of a difference, in variances for each coordinate, that noise may explain."""


class Drift:
    """Uncertainty of a solved chain, relative to poses of the chain.

    It grows along the chain until a loop is closed, so it is computed from the whole covariance.
    """

    def __init__(self, problem: ChainProblem, settled: Solution[Chained]) -> None:
        self.state, self.unit = settled.state, problem.unit
        self.unknown, self._problem, pattern = problem.unknown, problem, problem.pattern
        self._factor = problem.equations(self.state, settled.weight, True, 0.0).matrix
        pattern.factorise(self._factor)
        self._turns = problem.pose[:, : problem.pose.shape[1] - self.state.t.shape[1]]
        # Observations are sorted by time.
        chain, self.last = problem.chain, np.zeros(len(problem.unknown), dtype=np.int64)
        self.last[chain.landmark] = chain.iteration
        self.first = np.zeros_like(self.last)
        self.first[chain.landmark[::-1]] = chain.iteration[::-1]

    @cached_property
    def _own(self) -> tuple[Floats, Floats]:
        """Covariances of landmarks (m, d, d) and of turns (k, q, q)."""
        pattern = self._problem.pattern
        inverse = pattern.inverse(self._factor)
        return pattern.parts(inverse, self._problem.unknown), pattern.parts(inverse, self._turns)

    def between(self, unknowns: Ints) -> Floats:
        """Return the covariances (k, d, d) of the difference of points that coincide, metres.

        `unknowns` (k, 2, d): the unknowns of two landmarks, or of the positions of two poses.
        """
        pattern, d = self._problem.pattern, unknowns.shape[2]
        found = np.zeros((len(unknowns), d, d))
        for k, (one, other) in enumerate(unknowns):
            columns = np.zeros((pattern.n_unknowns, d))
            columns[one, np.arange(d)] += 1.0
            columns[other, np.arange(d)] -= 1.0
            found[k] = pattern.products(self._factor, columns)
        return found

    def strain(self, unknowns: Ints, off: Floats, noise_m: float) -> float:
        """Return how strained the chain is if landmarks that lie apart are the same.

        `unknowns` (k, 2, d): the unknowns of two landmarks each; `off` (k, d), metres: difference
        of their positions, of standard deviation `noise_m`. Returns by how many variances the least
        squares grow for each step of odometry that shares the correction: drift is the sum of small
        errors of many steps, but two storeys can only be one if a few steps are very wrong. 0 if
        noise explains it.
        """
        problem, columns = self._problem, np.arange(off.size).reshape(off.shape)
        apart = np.zeros((problem.pattern.n_unknowns, off.size))
        apart[unknowns[:, 0], columns] += 1.0
        apart[unknowns[:, 1], columns] -= 1.0
        spread = problem.pattern.solve(self._factor, apart)
        covariance = apart.T @ spread + noise_m**2 * np.eye(off.size)
        pull = np.linalg.solve(covariance, off.ravel())
        grown = float(off.ravel() @ pull)
        if grown <= EXPLAINED * off.size:
            return 0.0
        square = problem.odometry_squares(self.state, spread @ pull)
        shared = np.sum(square) ** 2 / max(np.sum(square**2), 1e-300)
        return grown / max(float(shared), 1.0)

    def from_poses(self, poses: Ints) -> tuple[Floats, Floats]:
        """Return the standard deviations (p, m) of landmarks and directions, from each pose (p,).

        Metres, along the axis of the largest variance; and radians, of the robot's direction
        relative to that when it last saw the landmark.
        """
        own = self._problem.pose[poses]
        right = np.zeros((self._problem.pattern.n_unknowns, own.size))
        right[own.ravel(), np.arange(own.size)] = 1.0
        columns = self._problem.pattern.solve(self._factor, right)
        each = np.split(columns, len(poses), axis=1)
        found = [self._from_pose(*of) for of in zip(poses.tolist(), each, strict=True)]
        sd_m, sd_rad = np.swapaxes(found, 0, 1)
        return sd_m, sd_rad

    def _from_pose(self, pose: int, columns: Floats) -> tuple[Floats, Floats]:
        """Return the deviations (m,) from a pose, given its columns (u, c) of the covariance."""
        problem, state = self._problem, self.state
        by_pose = -derivatives(state.positions - state.t[pose])
        of_pose, mixed = columns[problem.pose[pose]], columns[problem.unknown]
        across = by_pose @ np.swapaxes(mixed, 1, 2)
        own, own_turn = self._own
        found = by_pose @ of_pose @ np.swapaxes(by_pose, 1, 2) + own
        found = found + across + np.swapaxes(across, 1, 2)
        sd_m = np.sqrt(np.linalg.eigvalsh(found)[:, -1].clip(0))
        q = self._turns.shape[1]
        turned = columns[self._turns[self.last]][:, :, :q]
        turn = of_pose[:q, :q] + own_turn[self.last] - turned - np.swapaxes(turned, 1, 2)
        return sd_m, np.sqrt(np.linalg.eigvalsh(turn)[:, -1].clip(0))
