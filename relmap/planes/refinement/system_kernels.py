"""Residuals of walls and corners with their Jacobians, compiled; see `system`."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper


@helper
def _directions(angle: Floats) -> tuple[Floats, Floats]:
    cos, sin = np.empty(len(angle)), np.empty(len(angle))
    for k in range(len(angle)):
        cos[k], sin[k] = math.cos(angle[k]), math.sin(angle[k])
    return cos, sin


@compiled
def linearised(
    seen: tuple[Floats, Ints, Ints, Ints],
    poses: tuple[Floats, Floats],
    walls: tuple[Floats, Floats, Floats, Floats],
) -> tuple[Floats, Floats, Floats]:
    """Return the distances of points from their lines, and of corners along theirs.

    Also returns the Jacobians by the pose (r, 3), and by the wall's angle and distance, or the
    corner's position (r, 2).  `seen` are points (r, 2), iteration and wall (r,) and corner (k,), of
    the last k rows; `poses` yaw (i,) and t (i, 2); `walls` centre (w, 2), angle and across (w,),
    and along (c,).
    """
    points, iteration, wall, corner = seen
    (yaw, t), (centre, angle, across, along) = poses, walls
    n = len(points)
    off, by_pose, by_wall = np.empty(n), np.empty((n, 3)), np.empty((n, 2))
    (cos, sin), (cos_yaw, sin_yaw) = _directions(angle), _directions(yaw)
    for r in range(n):
        i, w, k = iteration[r], wall[r], r - (n - len(corner))
        vx, vy, c, s, place = cos[w], sin[w], cos_yaw[i], sin_yaw[i], across[w]
        if k >= 0:  # along the wall, from right to left
            vx, vy, place = vy, -vx, along[corner[k]]
        x, y = c * points[r, 0] - s * points[r, 1], s * points[r, 0] + c * points[r, 1]
        far_x, far_y = x + t[i, 0] - centre[w, 0], y + t[i, 1] - centre[w, 1]
        off[r] = vx * far_x + vy * far_y - place
        by_pose[r, 0], by_pose[r, 1], by_pose[r, 2] = vy * x - vx * y, vx, vy
        by_wall[r, 0], by_wall[r, 1] = vx * far_y - vy * far_x, -1.0
    return off, by_pose, by_wall
