"""The joint least squares over walls with the poses eliminated; see `relmap.planes.refinement`.

`seen` are iteration (n,), wall (n,), points (n, 2, 2), corner_row (k,), corner_at (k, 2) and
corner (k,): two points of each wall seen and the static corners, robot frame; `state` are yaw (i,),
t (i, 2), centre (w, 2), angle (w,), across (w,) and along (c,).  Rows and corners of iteration `i`
are those from `begin[i]` and `corner_begin[i]` on.  The unknowns that stay: 2 of each wall, its
angle and its distance across, then one of each corner.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled
from relmap.core.kernels.joint import subtract
from relmap.core.kernels.linear import inverse3, product

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Seen = tuple[Index, Index, Array, Index, Array, Index]
State = tuple[Array, Array, Array, Array, Array, Array]

LOOSE = 1e-12
"""What holds a pose that hangs by too little, as a share of what holds it otherwise."""


@compiled
def _residual(
    state: State, i: int, wall: int, x: float, y: float, lengthwise: bool
) -> tuple[float, float, float, float, float]:
    """Return how far a point seen in iteration i is from a wall's line, or along it.

    With the derivatives: by the yaw, by x and y, by the angle of the wall.
    """
    yaw, t, centre, angle, across, _ = state
    c, s = math.cos(yaw[i]), math.sin(yaw[i])
    arm_x, arm_y = c * x - s * y, s * x + c * y
    off_x, off_y = arm_x + t[i, 0] - centre[wall, 0], arm_y + t[i, 1] - centre[wall, 1]
    nx, ny = math.cos(angle[wall]), math.sin(angle[wall])
    if lengthwise:
        ux, uy = ny, -nx
        return ux * off_x + uy * off_y, uy * arm_x - ux * arm_y, ux, uy, nx * off_x + ny * off_y
    residual = nx * off_x + ny * off_y - across[wall]
    return residual, ny * arm_x - nx * arm_y, nx, ny, -(ny * off_x - nx * off_y)


@compiled
def residuals(seen: Seen, state: State) -> tuple[Array, Array]:
    """Return how far points (n, 2) are from their lines and corners (k,) along theirs, metres."""
    iteration, wall, points, corner_row, corner_at, corner = seen
    across, along = np.empty((len(wall), 2)), np.empty(len(corner))
    for r in range(len(wall)):
        for p in range(2):
            x, y = points[r, p]
            across[r, p] = _residual(state, iteration[r], wall[r], x, y, False)[0]
    for k in range(len(corner)):
        r = corner_row[k]
        x, y = corner_at[k]
        along[k] = _residual(state, iteration[r], wall[r], x, y, True)[0] - state[5][corner[k]]
    return across, along


@compiled
def scan_medians(across: Array, along: Array, begin: Index, corner_begin: Index) -> Array:
    """Return the median size of the values of each iteration; (i,)."""
    n = len(begin) - 1
    found = np.empty(n)
    for i in range(n):
        own = np.concatenate(
            (
                across[begin[i] : begin[i + 1]].copy().reshape(-1),
                along[corner_begin[i] : corner_begin[i + 1]],
            )
        )
        own = np.sort(np.abs(own))
        found[i] = own[(len(own) - 1) // 2]
    return found


@compiled
def _add(
    own: Array,
    right: Array,
    coupling: Array,
    pose: Array,
    pose_right: Array,
    line: int,
    other: int,
    w: float,
    off: float,
    by: tuple[float, float, float, float],
) -> None:
    """Add a residual of weight w, with its derivatives by a wall's angle and by the pose.

    That by `other`, the distance across or the place along, is -1.
    """
    own[line, line] += w * by[0] * by[0]
    own[line, other] -= w * by[0]
    own[other, line] -= w * by[0]
    own[other, other] += w
    right[line] -= w * by[0] * off
    right[other] += w * off
    for p in range(3):
        coupling[line, p] += w * by[0] * by[p + 1]
        coupling[other, p] -= w * by[p + 1]
        pose_right[p] -= w * by[p + 1] * off
        for o in range(3):
            pose[p, o] += w * by[p + 1] * by[o + 1]


@compiled
def _one_scan(
    seen: Seen,
    state: State,
    weights: tuple[Array, Array],
    i: int,
    rows: tuple[int, int],
    corners: tuple[int, int],
) -> tuple[Index, Array, Array, Array, Array, Array]:
    """Return what one iteration says.

    Returns
    -------
    nodes (u,), their matrix (u, u) and right side (u,), their coupling to the pose (u, 3), the
    matrix (3, 3) and right side (3,) of the pose.
    """
    _, wall, points, corner_row, corner_at, corner = seen
    first, m, k = rows[0], rows[1] - rows[0], corners[1] - corners[0]
    u = 2 * m + k
    nodes, own, right = np.empty(u, dtype=np.int64), np.zeros((u, u)), np.zeros(u)
    coupling, pose, pose_right = np.zeros((u, 3)), np.zeros((3, 3)), np.zeros(3)
    lines = 2 * len(state[3])
    for a in range(2 * m + k):
        # Two points of each wall, then the corners.
        lengthwise = a >= 2 * m
        q = corners[0] + a - 2 * m if lengthwise else first + a // 2
        r = corner_row[q] if lengthwise else q
        x, y = corner_at[q] if lengthwise else points[r, a % 2]
        w = weights[1][q] if lengthwise else weights[0][r, a % 2]
        off, by_yaw, by_x, by_y, by_angle = _residual(state, i, wall[r], x, y, lengthwise)
        line = 2 * (r - first)
        other = a if lengthwise else line + 1
        nodes[line], nodes[line + 1] = 2 * wall[r], 2 * wall[r] + 1
        if lengthwise:
            nodes[a] = lines + corner[q]
            off -= state[5][corner[q]]
        by = (by_angle, by_yaw, by_x, by_y)
        _add(own, right, coupling, pose, pose_right, line, other, w, off, by)
    for p in range(3):
        pose[p, p] += LOOSE * pose[p, p] + 1e-300
    return nodes, own, right, coupling, pose, pose_right


@compiled
def wall_equations(
    seen: Seen,
    state: State,
    weights: tuple[Array, Array],
    begin: Index,
    corner_begin: Index,
    buffer: Array,
    layout: tuple[Index, Index, Index, Index],
) -> Array:
    """Add the normal equations of walls and corners to a matrix; return their right side (u,).

    The first iteration stays where it is.
    """
    level, place, width, offset = layout
    total = np.zeros(len(level))
    for i in range(len(begin) - 1):
        rows, corners = (begin[i], begin[i + 1]), (corner_begin[i], corner_begin[i + 1])
        nodes, part, right, coupling, pose, pose_right = _one_scan(
            seen, state, weights, i, rows, corners
        )
        if i > 0:
            inverse, positive = inverse3(pose)
            if not positive:
                continue
            away = product(coupling, inverse)
            for a in range(len(nodes)):
                for p in range(3):
                    right[a] -= away[a, p] * pose_right[p]
                    for b in range(len(nodes)):
                        part[a, b] -= away[a, p] * coupling[b, p]
        subtract(-part, nodes, 1, buffer, level, place, width, offset)
        for a in range(len(nodes)):
            total[nodes[a]] += right[a]
    return total


@compiled
def pose_steps(
    seen: Seen,
    state: State,
    weights: tuple[Array, Array],
    begin: Index,
    corner_begin: Index,
    step: Array,
) -> Array:
    """Return the steps (i, 3) of the poses that belong to a step (u,) of walls and corners."""
    found = np.zeros((len(begin) - 1, 3))
    for i in range(1, len(begin) - 1):
        rows, corners = (begin[i], begin[i + 1]), (corner_begin[i], corner_begin[i + 1])
        nodes, _, _, coupling, pose, pose_right = _one_scan(seen, state, weights, i, rows, corners)
        inverse, positive = inverse3(pose)
        for p in range(3):
            for a in range(len(nodes)):
                pose_right[p] -= coupling[a, p] * step[nodes[a]]
        for p in range(3):
            for o in range(3):
                found[i, p] += inverse[p, o] * pose_right[o] if positive else 0.0
    return found
