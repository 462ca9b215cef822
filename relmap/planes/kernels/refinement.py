"""The joint least squares over walls with the poses eliminated; see `relmap.planes.refinement`.

`seen` are iteration (n,), wall (n,), points (n, 2, 2), corner_row (k,), corner_at (k, 2), corner
(k,) and open_along (i, 2): two points of each wall seen and the static corners, robot frame, and
the direction, if any, in which an iteration saw nothing that tells where it was.  `state` are yaw
(i,), t (i, 2), centre (w, 2), angle (w,), across (w,) and along (c,).  Rows and corners of one
iteration are those from `begin[i]` and `corner_begin[i]` on.  The unknowns: 2 of each wall, its
angle and its distance across, then one of each corner; `nodes` (v,) lists those of iteration after
iteration in this order, from ``2 begin[i] + corner_begin[i]`` on.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled
from relmap.core.kernels.linear import inverse3, product

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Seen = tuple[Index, Index, Array, Index, Array, Index, Array]
State = tuple[Array, Array, Array, Array, Array, Array]

LOOSE, STIFF = 1e-10, 1e3
"""What holds a pose that hangs by too little, and one where nothing tells of it, as a share of what
holds it otherwise."""


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
    iteration, wall, points, corner_row, corner_at, corner, _ = seen
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
) -> tuple[Array, Array, Array, Array, Array]:
    """Return what one iteration says.

    Returns
    -------
    Of its nodes the matrix (u, u) and right side (u,), their coupling to the pose (u, 3), the
    matrix (3, 3) and right side (3,) of the pose.
    """
    _, wall, points, corner_row, corner_at, corner, open_along = seen
    first, m, k = rows[0], rows[1] - rows[0], corners[1] - corners[0]
    u = 2 * m + k
    own, right = np.zeros((u, u)), np.zeros(u)
    coupling, pose, pose_right = np.zeros((u, 3)), np.zeros((3, 3)), np.zeros(3)
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
        if lengthwise:
            off -= state[5][corner[q]]
        by = (by_angle, by_yaw, by_x, by_y)
        _add(own, right, coupling, pose, pose_right, line, other, w, off, by)
    c, s = math.cos(state[0][i]), math.sin(state[0][i])
    x, y = open_along[i]
    way, shift = (0.0, c * x - s * y, s * x + c * y), pose[1, 1] + pose[2, 2]
    for p in range(3):
        for o in range(3):
            pose[p, o] += STIFF * shift * way[p] * way[o]
        pose[p, p] += LOOSE * (pose[0, 0] if p == 0 else shift) + 1e-300
    return own, right, coupling, pose, pose_right


@compiled
def entries(
    begin: Index, nodes: Index, pointer: NDArray[np.int32], row: NDArray[np.int32]
) -> Index:
    """Return where in a sparse matrix the pairs of nodes of each iteration are, one after another.

    The matrix goes column by column: `row` (nnz,), ascending in each, from `pointer` on.
    """
    total = 0
    for i in range(len(begin) - 1):
        total += (begin[i + 1] - begin[i]) ** 2
    found, at = np.empty(total, dtype=np.int64), 0
    for i in range(len(begin) - 1):
        for a in range(begin[i], begin[i + 1]):
            low = pointer[nodes[a]]
            column = row[low : pointer[nodes[a] + 1]]
            for b in range(begin[i], begin[i + 1]):
                found[at] = low + np.searchsorted(column, nodes[b])
                at += 1
    return found


@compiled
def wall_equations(
    seen: Seen,
    state: State,
    weights: tuple[Array, Array],
    begin: Index,
    corner_begin: Index,
    nodes: Index,
    entry: Index,
    matrix: Array,
) -> tuple[Array, Array, Array]:
    """Add the normal equations of walls and corners to a matrix, poses eliminated.

    The first iteration stays where it is.  `entry` is as from `entries`.

    Returns
    -------
    right (u,)
        Right side.
    away (v, 3)
        By how much a step of each node moves the pose back; see `pose_steps`.
    pose_step (i, 3)
        The steps of the poses if no node moved.
    """
    total, at = np.zeros(nodes.max() + 1), 0
    away, pose_step = np.zeros((len(nodes), 3)), np.zeros((len(begin) - 1, 3))
    for i in range(len(begin) - 1):
        rows, corners = (begin[i], begin[i + 1]), (corner_begin[i], corner_begin[i + 1])
        own, right, coupling, pose, pose_right = _one_scan(seen, state, weights, i, rows, corners)
        first, m = 2 * begin[i] + corner_begin[i], len(right)
        inverse, positive = inverse3(pose)
        if i > 0 and positive:
            away[first : first + m] = product(coupling, inverse)
            for p in range(3):
                for o in range(3):
                    pose_step[i, p] += inverse[p, o] * pose_right[o]
        for a in range(m):
            node = nodes[first + a]
            total[node] += right[a]
            for p in range(3):
                total[node] -= away[first + a, p] * pose_right[p]
            for b in range(m):
                value = own[a, b]
                for p in range(3):
                    value -= away[first + a, p] * coupling[b, p]
                matrix[entry[at]] += value
                at += 1
    return total, away, pose_step


@compiled
def pose_steps(begin: Index, nodes: Index, away: Array, pose_step: Array, step: Array) -> Array:
    """Return the steps (i, 3) of the poses that belong to a step (u,) of walls and corners."""
    found = pose_step.copy()
    for i in range(len(begin) - 1):
        for a in range(begin[i], begin[i + 1]):
            for p in range(3):
                found[i, p] -= away[a, p] * step[nodes[a]]
    return found
