"""What a chain of poses is solved from, and for: observations and odometry, landmarks and poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints


class Chain(NamedTuple):
    """The data: observations, and odometry between iterations.

    `points` (n, d), robot frame, metres. `landmark` (n,): 0 to m - 1. `iteration` (n,): 0 to k - 1.
    `root` (n, d, d): matrix that converts a residual to standard deviations. `motion`
    (k - 1, 4, 4): odometry from each iteration to the next; NaN if unknown.
    """

    points: Floats
    landmark: Ints
    iteration: Ints
    root: Floats
    motion: Floats

    def only(self, rows: Bools) -> Chain:
        """Return the chain with only these of its observations (n,)."""
        points, landmark, iteration = self.points[rows], self.landmark[rows], self.iteration[rows]
        return Chain(points, landmark, iteration, self.root[rows], self.motion)


@dataclass(frozen=True, eq=False)
class Chained:
    """Landmarks, the pose of each iteration, and the constant errors of odometry.

    `positions` (m, d), metres; `R` (k, d, d); `t` (k, d); `constant` (q + 2,): error of the scale
    of distances and of turns, and turn missed per metre.
    """

    positions: Floats
    R: Floats
    t: Floats
    constant: Floats


class Sigmas(NamedTuple):
    """Standard deviations, as multiples of those that weight the residuals.

    `seen`, `way`, `turn`: of observations, and of the distance and the turn of odometry.
    """

    seen: float = 1.0
    way: float = 1.0
    turn: float = 1.0


def unexplained(chain: Chain, state: Chained) -> Floats:
    """Return the residuals (n, d) of observations, in standard deviations by their roots."""
    return np.asarray(np.einsum("nij,nj->ni", chain.root, off_by(chain, state)))


def off_by(chain: Chain, state: Chained) -> Floats:
    """Return by how much (n, d) landmarks are off where they were observed, metres."""
    at = chain.iteration
    away = state.positions[chain.landmark] - state.t[at]
    return np.asarray(np.einsum("nji,nj->ni", state.R[at], away) - chain.points)
