"""Joint least squares over all observations of walls and corners.

A wall seen in part says nothing along itself, however often it is seen, but all the more about the
turn and the distance across.  Points of equal weight in all directions cannot say this, so walls
have equations of their own: each observation of a wall tells how far from the wall's line two of
its points are, and each static corner how far along the line it is.  Where the robot was is a
nuisance, as in `relmap.core.refinement`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

SETTLED = 1e-3
"""Largest step, metres and radians, in typical standard deviations, of a settled solution."""
USUAL = 3.0
"""No residual is in doubt that is not larger than so many typical ones, of all or of its scan."""
SPREAD = 1 / np.sqrt(12)
"""Where the two points are that stand for a wall: so many sizes from its middle, either way.

A line fitted to points spread evenly over the wall is as sure as if it were fitted to these two,
each twice as uncertain (in variance) as the middle."""
HELD = 1e-9
"""What holds an unknown that nothing does, as a share of the largest weight."""


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


def refine_walls(given: WallEquations, state: Walls, rounds: int, doubtful: float) -> Walls:
    """Return the state on which all observations agree best, by Gauss-Newton.

    The first iteration stays where it is.

    Parameters
    ----------
    given : WallEquations
    state : Walls
        Where to start.
    rounds : int
        Most steps.
    doubtful : float
        Residual, in standard deviations, from which one counts less and less (Geman and McClure,
        1987): a wall taken for another one should not count at all.
    """
    settled = SETTLED * float(np.median(given.sd))
    for _ in range(rounds):
        step = _step(given, state, doubtful)
        i, w = len(state.yaw), len(state.angle)
        state = Walls(
            state.yaw + step[: 3 * i : 3],
            state.t + np.column_stack([step[1 : 3 * i : 3], step[2 : 3 * i : 3]]),
            state.centre,
            state.angle + step[3 * i : 3 * i + 2 * w : 2],
            state.across + step[3 * i + 1 : 3 * i + 2 * w : 2],
            state.along + step[3 * i + 2 * w :],
        )
        if np.abs(step).max(initial=0.0) < settled:
            break
    return state


def _step(given: WallEquations, state: Walls, doubtful: float) -> NDArray[np.float64]:
    """Return the next step of all unknowns: poses (3 each), lines (2 each), corners."""
    i, w, c = len(state.yaw), len(state.angle), len(state.along)
    middle = given.ends.mean(axis=1)
    half = SPREAD * (given.ends[:, 1] - given.ends[:, 0])
    row = np.arange(len(given.wall))
    blocks = [
        _across(given, state, row, middle - half),
        _across(given, state, row, middle + half),
        _along(given, state),
    ]
    sd = np.concatenate([np.sqrt(2) * given.sd, np.sqrt(2) * given.sd, given.corner_sd])
    residual = np.concatenate([block[0] for block in blocks])
    weight = 1 / sd**2
    off = np.abs(residual) / sd
    at = np.concatenate([given.iteration, given.iteration, given.iteration[given.corner_row]])
    usual = np.maximum(medians(at, off)[at], np.median(off))
    weight /= (1 + (off / np.maximum(doubtful, USUAL * usual)) ** 2) ** 2
    columns = np.concatenate([block[1] for block in blocks])
    values = np.concatenate([block[2] for block in blocks])
    n, width = columns.shape
    A = coo_array(
        (values.ravel(), (np.repeat(np.arange(n), width), columns.ravel())),
        shape=(n, 3 * i + 2 * w + c),
    ).tocsc()
    held = np.full(A.shape[1], HELD * weight.max(initial=1.0))
    held[:3] = 1e6 * weight.max(initial=1.0)
    WA = A.multiply(weight[:, None]).tocsc()
    H = csc_array(A.T @ WA)
    H.setdiag(H.diagonal() + held)
    # The matrix is positive definite: pivoting would only fill it.
    factor = splu(
        H,
        permc_spec="MMD_AT_PLUS_A",
        options={"SymmetricMode": True, "DiagPivotThresh": 0.0},
    )
    return np.asarray(factor.solve(-(WA.T @ residual)))


def _across(
    given: WallEquations, state: Walls, row: NDArray[np.int64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Return residuals (n,) of points to their lines, and derivatives: columns, values (n, 6)."""
    at, wall = given.iteration[row], given.wall[row]
    turned, arm = _placed(state, at, points)
    normal = np.column_stack([np.cos(state.angle[wall]), np.sin(state.angle[wall])])
    along = np.column_stack([normal[:, 1], -normal[:, 0]])
    off = turned - state.centre[wall]
    residual = (normal * off).sum(axis=1) - state.across[wall]
    lines = 3 * len(state.yaw) + 2 * wall
    columns = np.column_stack([3 * at, 3 * at + 1, 3 * at + 2, lines, lines + 1, lines])
    values = np.column_stack(
        [
            (normal * arm).sum(axis=1),
            normal,
            -(along * off).sum(axis=1),
            -np.ones(len(row)),
            np.zeros(len(row)),
        ]
    )
    return residual, columns, values


def _along(
    given: WallEquations, state: Walls
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Return residuals (k,) of corners along their lines, and derivatives (k, 6)."""
    row = given.corner_row
    at, wall = given.iteration[row], given.wall[row]
    placed, arm = _placed(state, at, given.ends[row, given.corner_end])
    normal = np.column_stack([np.cos(state.angle[wall]), np.sin(state.angle[wall])])
    along = np.column_stack([normal[:, 1], -normal[:, 0]])
    off = placed - state.centre[wall]
    residual = (along * off).sum(axis=1) - state.along[given.corner]
    lines = 3 * len(state.yaw) + 2 * wall
    corner = 3 * len(state.yaw) + 2 * len(state.angle) + given.corner
    columns = np.column_stack([3 * at, 3 * at + 1, 3 * at + 2, lines, lines + 1, corner])
    values = np.column_stack(
        [
            (along * arm).sum(axis=1),
            along,
            (normal * off).sum(axis=1),
            np.zeros(len(row)),
            -np.ones(len(row)),
        ]
    )
    return residual, columns, values


def _placed(
    state: Walls, at: NDArray[np.int64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (n, 2) in the map frame, and their derivatives by the yaw."""
    c, s = np.cos(state.yaw[at]), np.sin(state.yaw[at])
    x, y = points.T
    turned = np.column_stack([c * x - s * y, s * x + c * y])
    return turned + state.t[at], np.column_stack([-turned[:, 1], turned[:, 0]])


def across_residuals(given: WallEquations, state: Walls) -> NDArray[np.float64]:
    """Return how far the middles of observed walls are from their lines; (n,) metres."""
    return _across(given, state, np.arange(len(given.wall)), given.ends.mean(axis=1))[0]


def along_residuals(given: WallEquations, state: Walls) -> NDArray[np.float64]:
    """Return how far observed corners are from their places, along their lines; (k,) metres."""
    return _along(given, state)[0]


def medians(of: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lower median of the values (n,) of each set 0, 1, ...; none may be empty."""
    n = np.bincount(of)
    first = np.cumsum(n) - n
    return np.asarray(values[np.lexsort((values, of))][first + (n - 1) // 2])
