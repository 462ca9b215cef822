"""Observations of walls, the state that is solved for, and its unobservable directions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.planes.odometry.steps import MotionFactors

PARALLEL = np.sin(np.deg2rad(3.0)) ** 2
"""Smallest spread of wall directions that determines the position along the walls."""


@dataclass(frozen=True, eq=False)
class WallEquations:
    """Observations of walls; n observed walls, k observed corners.

    `iteration`, `wall` (n,); `ends` (n, 2, 2), robot frame, metres. `sd` (n,), metres: standard
    deviation of the distance to a wall at its middle. `corner_row` (k,): row of the wall of each
    observed corner. `corner_end` (k,): 0 for the right end, 1 for the left one. `corner` (k,):
    corner number; each belongs to one wall. `corner_sd` (k,), metres: standard deviation along the
    wall. `odometry`: used where walls alone do not determine the motion.
    """

    iteration: Ints
    wall: Ints
    ends: Floats
    sd: Floats
    corner_row: Ints
    corner_end: Ints
    corner: Ints
    corner_sd: Floats
    odometry: MotionFactors = field(default_factory=MotionFactors)

    @property
    def n_iterations(self) -> int:
        """Number of iterations."""
        return 1 + int(max(self.iteration[-1], self.odometry.both.max(initial=0)))


@dataclass(eq=False)
class Walls:
    """Poses, wall lines, and positions of corners along them: the state that is solved for.

    `yaw` (i,), `t` (i, 2): pose of each iteration: ``T_map_robot``; `centre` (w, 2): a fixed point
    near each wall; `angle`, `across` (w,): direction of the normal, and distance of the line from
    the centre; `along` (c,): position of each corner along its wall, from the centre.
    """

    yaw: Floats
    t: Floats
    centre: Floats
    angle: Floats
    across: Floats
    along: Floats


def open_along(given: WallEquations) -> Floats:
    """Return the unobservable direction (i, 2) of each iteration, robot frame.

    The direction of its walls if they are parallel and show no corner; 0 otherwise, and where
    odometry is used. Without this, the noise of nearly parallel walls would create a false
    constraint.
    """
    n = given.n_iterations
    along = given.ends[:, 1] - given.ends[:, 0]
    x, y = (along / np.linalg.norm(along, axis=1, keepdims=True)).T
    xx, xy, yy = (np.bincount(given.iteration, v, minlength=n) for v in (x * x, x * y, y * y))
    # The principal axes of the sum of the directions' outer products, and the smaller eigenvalue.
    spread = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    angle = np.arctan2(2 * xy, xx - yy) / 2
    is_open = spread < PARALLEL
    is_open[given.iteration[given.corner_row]] = False
    is_open[given.odometry.both.ravel()] = False
    return np.where(is_open[:, None], np.column_stack([np.cos(angle), np.sin(angle)]), 0.0)


def between_neighbours(state: Walls, along: Floats) -> Walls:
    """Return the state with unobservable positions interpolated at constant speed (motion model).

    `along` (i, 2): as returned by `open_along`.
    """
    is_open = along.any(axis=1)
    known = np.flatnonzero(~is_open)
    inside = np.flatnonzero(is_open)
    if not len(known):
        return state
    inside = inside[(inside > known[0]) & (inside < known[-1])]
    c, s = np.cos(state.yaw[inside]), np.sin(state.yaw[inside])
    x, y = along[inside].T
    u = np.column_stack([c * x - s * y, s * x + c * y])
    even = np.column_stack([np.interp(inside, known, axis[known]) for axis in state.t.T])
    t = state.t.copy()
    t[inside] += ((even - t[inside]) * u).sum(axis=1)[:, None] * u
    return replace(state, t=t)
