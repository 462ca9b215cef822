"""Joint least squares over all observations of walls and corners.

A wall seen in part says nothing along itself, however often it is seen, but all the more about the
turn and the distance across.  Points of equal weight in all directions cannot say this, so walls
have equations of their own: each observation of a wall tells how far from the wall's line two of
its points are, and each static corner how far along the line it is.  Where the robot was is a
nuisance, as in `relmap.core.refinement`.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

SETTLED = 0.01
"""Step, in typical standard deviations, of a settled solution: most unknowns do no more."""
MOST = 0.9
NEAR = 0.005
"""Step, metres and radians, of a solution that is good enough to go on from with other weights."""
USUAL = 3.0
"""No residual is in doubt that is not larger than so many typical ones, of all or of its scan."""
SPREAD = 1 / np.sqrt(12)
"""Where the two points are that stand for a wall: so many sizes from its middle, either way.

A line fitted to points spread evenly over the wall is as sure as if it were fitted to these two,
each twice as uncertain (in variance) as the middle."""

PARALLEL = np.sin(np.deg2rad(3.0)) ** 2
"""Walls whose directions spread by less do not tell where they were seen from, along themselves."""
LOOSE, LEAST = 1e-12, 1e-9
"""What holds an unknown that hangs by too little, as a share of what holds it otherwise, and in
weights of an observation."""


@dataclass(frozen=True, eq=False)
class WallEquations:
    """What is known of walls; n observed walls, k observed corners.

    Attributes
    ----------
    iteration, wall : (n,) int64
    ends : (n, 2, 2) float64, robot frame, metres
    sd : (n,) float64, metres
        Standard deviation of the distance to a wall at its middle.
    corner_row : (k,) int64
        The row of each observed corner's wall.
    corner_end : (k,) int64
        0 for the right end, 1 for the left one.
    corner : (k,) int64
    corner_sd : (k,) float64, metres
        Standard deviation along the wall.
    """

    iteration: NDArray[np.int64]
    wall: NDArray[np.int64]
    ends: NDArray[np.float64]
    sd: NDArray[np.float64]
    corner_row: NDArray[np.int64]
    corner_end: NDArray[np.int64]
    corner: NDArray[np.int64]
    corner_sd: NDArray[np.float64]


@dataclass(eq=False)
class Walls:
    """Lines, and how far along them corners are; the state that is solved for.

    Attributes
    ----------
    yaw : (i,) float64, t : (i, 2) float64
        Where each iteration was: ``T_map_robot``.
    centre : (w, 2) float64
        A fixed point near each wall.
    angle, across : (w,) float64
        Direction of the normal, and distance of the line from the centre.
    along : (c,) float64
        Place of each corner along its wall, from the centre.
    """

    yaw: NDArray[np.float64]
    t: NDArray[np.float64]
    centre: NDArray[np.float64]
    angle: NDArray[np.float64]
    across: NDArray[np.float64]
    along: NDArray[np.float64]


class WallSystem:
    """The equations of the walls of one set of observations, poses eliminated.

    Parameters
    ----------
    given : WallEquations
        In the order of iterations.
    """

    def __init__(self, given: WallEquations) -> None:
        middle = given.ends.mean(axis=1, keepdims=True)
        points = middle + SPREAD * np.array([[-1.0], [1.0]]) * (
            given.ends[:, 1:] - given.ends[:, :1]
        )
        corner_at = given.ends[given.corner_row, given.corner_end]
        self._given = given
        self._seen = (
            given.iteration,
            given.wall,
            points,
            given.corner_row,
            corner_at,
            given.corner,
            open_along(given),
        )
        every = np.arange(given.iteration[-1] + 2)
        self._begin = np.searchsorted(given.iteration, every)
        self._corner_begin = np.searchsorted(given.iteration[given.corner_row], every)
        self._prepare()

    def refine(
        self,
        state: Walls,
        rounds: int,
        doubtful: float,
        by_scan: bool = True,
        settled: bool = True,
    ) -> Walls:
        """Return the state on which all observations agree best, by Gauss-Newton.

        The first iteration stays where it is.

        Parameters
        ----------
        state : Walls
            Where to start.
        rounds : int
            Most steps.
        doubtful : float
            Residual, in standard deviations, from which one counts less and less (Geman and
            McClure, 1987): a wall taken for another one should not count at all.
        by_scan : bool
            Whether a scan that is off as a whole is taken for misplaced as yet, rather than wrong.
        settled : bool
            Whether it should settle, rather than come near only.
        """
        enough = SETTLED * float(np.median(self._given.sd)) if settled else NEAR
        for _ in range(rounds):
            poses, lines, corners = self._step(state, self._weights(state, doubtful, by_scan))
            state = Walls(
                state.yaw + poses[:, 0],
                state.t + poses[:, 1:],
                state.centre,
                state.angle + lines[:, 0],
                state.across + lines[:, 1],
                state.along + corners,
            )
            step = np.concatenate([poses.ravel(), lines.ravel(), corners])
            if np.quantile(np.abs(step), MOST) < enough:
                break
        return between_neighbours(state, self._seen[-1])

    def reweighted(self, given: WallEquations) -> WallSystem:
        """Return the system of the same observations with other standard deviations."""
        system = copy(self)
        system._given = given
        return system

    def residuals(self, state: Walls) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how far walls (n, 2), at two points, and corners (k,) are from their places."""
        from relmap.planes.kernels.refinement import residuals

        return residuals(self._seen, _arrays(state))

    def _weights(
        self, state: Walls, doubtful: float, by_scan: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        from relmap.planes.kernels.refinement import scan_medians

        sd, corner_sd = np.sqrt(2) * self._given.sd[:, None], self._given.corner_sd
        across, along = self.residuals(state)
        across, along = np.abs(across) / sd, np.abs(along) / corner_sd
        usual = np.full(len(self._begin) - 1, np.median(np.concatenate([across.ravel(), along])))
        if by_scan:
            of_scan = scan_medians(across, along, self._begin, self._corner_begin)
            usual = np.maximum(usual, of_scan)
        limit = np.maximum(doubtful, USUAL * usual)
        at = limit[self._given.iteration]
        return (
            1 / (sd * (1 + (across / at[:, None]) ** 2)) ** 2,
            1 / (corner_sd * (1 + (along / at[self._given.corner_row]) ** 2)) ** 2,
        )

    def _step(
        self, state: Walls, weights: tuple[NDArray[np.float64], NDArray[np.float64]]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the next step of poses (i, 3), lines (w, 2) and corners (c,)."""
        from relmap.planes.kernels.refinement import pose_steps, wall_equations

        system = self._seen, _arrays(state), weights, self._begin, self._corner_begin, self._nodes
        matrix = self._pattern.copy()
        matrix.data = np.zeros(len(matrix.data))
        right, away, alone = wall_equations(*system, self._entry, matrix.data)
        matrix.data[self._diagonal] *= 1 + LOOSE
        matrix.data[self._diagonal] += LEAST
        # The matrix is positive definite: pivoting would only fill it.
        factor = splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            options={"SymmetricMode": True, "DiagPivotThresh": 0.0},
        )
        step = factor.solve(right)
        lines = 2 * len(state.angle)
        poses = pose_steps(self._node_begin, self._nodes, away, alone, step)
        return poses, step[:lines].reshape(-1, 2), step[lines:]

    def _prepare(self) -> None:
        """Find out which unknowns stand together in the equations, and where."""
        from relmap.planes.kernels.refinement import entries

        given, n = self._given, len(self._begin) - 1
        lines = 2 * (int(given.wall.max()) + 1)
        at = np.concatenate([np.repeat(given.iteration, 2), given.iteration[given.corner_row]])
        pairs = np.column_stack([2 * given.wall, 2 * given.wall + 1]).ravel()
        order = np.argsort(at, kind="stable")
        self._nodes = np.concatenate([pairs, lines + given.corner])[order]
        there = coo_array(
            (np.ones(len(at)), (at[order], self._nodes)), shape=(n, self._nodes.max() + 1)
        )
        self._pattern = csc_array(there.T @ there.tocsr())
        self._pattern.sort_indices()
        pointer, row = self._pattern.indptr, self._pattern.indices
        self._node_begin = 2 * self._begin + self._corner_begin
        self._entry = entries(self._node_begin, self._nodes, pointer, row)
        column = np.repeat(np.arange(len(pointer) - 1), np.diff(pointer))
        self._diagonal = np.flatnonzero(row == column)


def open_along(given: WallEquations) -> NDArray[np.float64]:
    """Return the direction (i, 2), robot frame, in which an iteration does not tell where it was.

    That of its walls, where they are parallel and none shows a corner; 0 elsewhere.  Walls that are
    parallel but for their noise would invent a constraint there.
    """
    n = int(given.iteration[-1]) + 1
    along = given.ends[:, 1] - given.ends[:, 0]
    x, y = (along / np.linalg.norm(along, axis=1, keepdims=True)).T
    xx, xy, yy = (np.bincount(given.iteration, v, minlength=n) for v in (x * x, x * y, y * y))
    # The axes of the sum of the directions' outer products, and the smaller eigenvalue.
    spread = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    angle = np.arctan2(2 * xy, xx - yy) / 2
    is_open = spread < PARALLEL
    is_open[given.iteration[given.corner_row]] = False
    return np.where(is_open[:, None], np.column_stack([np.cos(angle), np.sin(angle)]), 0.0)


def between_neighbours(state: Walls, along: NDArray[np.float64]) -> Walls:
    """Return the state with open iterations at even speed between others (motion model).

    Parameters
    ----------
    state : Walls
    along : (i, 2) float64
        As from `open_along`.
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


def _arrays(state: Walls) -> Any:
    """Return what the kernels know of a state."""
    return state.yaw, state.t, state.centre, state.angle, state.across, state.along


def medians(of: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lower median of the values (n,) of each set 0, 1, ...; none may be empty."""
    n = np.bincount(of)
    first = np.cumsum(n) - n
    return np.asarray(values[np.lexsort((values, of))][first + (n - 1) // 2])


def quantiles(
    of: NDArray[np.int64], values: NDArray[np.float64], share: float
) -> NDArray[np.float64]:
    """Return the quantile of the values (n,) of each set 0, 1, ..., as numpy interpolates it."""
    n = np.bincount(of)
    ordered = values[np.lexsort((values, of))]
    first = np.cumsum(n) - n
    place = share * (n - 1)
    below = np.floor(place).astype(np.int64)
    above = np.minimum(below + 1, n - 1)
    part = place - below
    return np.asarray((1 - part) * ordered[first + below] + part * ordered[first + above])
