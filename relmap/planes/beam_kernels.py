"""What beams of two scans say of a motion between them, compiled.

A scan is `points` (n, 2), robot frame, sorted by their `bearings` (n,) from `origin` (2,), where
the sensor is; `solid` (n,) tells which are on walls.  A motion is yaw, x, y from the frame of the
earlier scan into that of the later one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled

Array = NDArray[np.float64]
Fan = tuple[Array, Array, Array, NDArray[np.bool_]]

BESIDE = 3
"""Beams on either side of a point that it is compared with the surface between."""
GAP_M, GAP = 0.3, 0.1
"""Between beams farther apart, this and so much of the range, there is no surface."""
GAP_RAD = 0.1
"""Between bearings farther apart nothing was looked at."""


@compiled
def _distance(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the distance of a point from a segment, or where that is a gap from its ends."""
    ux, uy, length = bx - ax, by - ay, (bx - ax) ** 2 + (by - ay) ** 2
    if length > (GAP_M + GAP * math.hypot(ax, ay)) ** 2:
        return min(math.hypot(x - ax, y - ay), math.hypot(x - bx, y - by))
    t = ((x - ax) * ux + (y - ay) * uy) / max(length, 1e-12)
    t = min(max(t, 0.0), 1.0)
    return math.hypot(x - ax - t * ux, y - ay - t * uy)


@compiled
def _compare(seen: Fan, other: Fan, motion: Array, near_m: float, step: int, sums: Array) -> None:
    """Add up how many points of `other`, brought into the frame of `seen`, agree with its beams.

    `sums` are those on a surface that was seen, those of walls before one, where a beam passed
    through, and those that nothing is known of.
    """
    points, bearings, origin, _ = seen
    c, s, n = math.cos(motion[0]), math.sin(motion[0]), len(bearings)
    for k in range(0, len(other[0]), step):
        x = c * other[0][k, 0] - s * other[0][k, 1] + motion[1]
        y = s * other[0][k, 0] + c * other[0][k, 1] + motion[2]
        i = int(np.searchsorted(bearings, math.atan2(y - origin[1], x - origin[0])))
        if i == 0 or i == n or bearings[i] - bearings[i - 1] > GAP_RAD:
            sums[2] += 1
            continue
        off = np.inf
        for j in range(max(i - BESIDE, 1), min(i + BESIDE + 1, n)):
            a, b = points[j - 1], points[j]
            off = min(off, _distance(x, y, a[0], a[1], b[0], b[1]))
        seen_m = min(
            math.hypot(points[i, 0] - origin[0], points[i, 1] - origin[1]),
            math.hypot(points[i - 1, 0] - origin[0], points[i - 1, 1] - origin[1]),
        )
        range_m = math.hypot(x - origin[0], y - origin[1])
        if off < near_m:
            sums[0] += 1 - 0.5 * (off / near_m) ** 2
        elif range_m < seen_m - 2 * near_m:
            sums[1 if other[3][k] else 2] += 1
        else:
            sums[2] += 1


@compiled
def compared(earlier: Fan, later: Fan, motions: Array, near_m: float, step: int) -> Array:
    """Return how many points of both scans agree, contradict and are not told of; (k, 3).

    For each of k motions; of every so many beams one is looked at.
    """
    sums = np.zeros((len(motions), 3))
    for k in range(len(motions)):
        motion = motions[k]
        c, s = math.cos(motion[0]), math.sin(motion[0])
        x, y = c * motion[1] + s * motion[2], -s * motion[1] + c * motion[2]
        back = np.array([-motion[0], -x, -y])
        _compare(later, earlier, motion, near_m, step, sums[k])
        _compare(earlier, later, back, near_m, step, sums[k])
    return sums


@compiled
def on_walls(points: Array, ends: Array, near_m: float) -> NDArray[np.bool_]:
    """Tell which points (n, 2) are on walls, by their ends (m, 2, 2)."""
    solid = np.zeros(len(points), dtype=np.bool_)
    for j in range(len(ends)):
        ax, ay = ends[j, 0]
        ux, uy = ends[j, 1, 0] - ax, ends[j, 1, 1] - ay
        size = math.hypot(ux, uy)
        for k in range(len(points)):
            x, y = points[k, 0] - ax, points[k, 1] - ay
            along = (x * ux + y * uy) / size
            if abs(x * uy - y * ux) / size < near_m and -near_m < along < size + near_m:
                solid[k] = True
    return solid
