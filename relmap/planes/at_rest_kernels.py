"""Which points of a scan are still there in a later one, compiled."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.linalg.compiling import compiled


@compiled
def seen_again(
    points: Floats,
    later: tuple[Floats, Floats, Floats],
    motion: Floats,
    near_m: float,
    behind_m: float,
) -> tuple[int, int]:
    """Return how many points (n, 2), moved into the frame of a later scan, are there, and gone.

    A scan is its points (m, 2), their bearings (m,), ascending, and the place of the sensor (2,).
    A point is there if one was seen nearer than `near_m`, and otherwise gone if both beams beside
    it end farther behind it than `behind_m`.
    """
    found, bearings, origin = later
    c, s, there, gone = math.cos(motion[0]), math.sin(motion[0]), 0, 0
    for k in range(len(points)):
        x = c * points[k, 0] - s * points[k, 1] + motion[1]
        y = s * points[k, 0] + c * points[k, 1] + motion[2]
        nearest = np.inf
        for j in range(len(found)):
            nearest = min(nearest, (x - found[j, 0]) ** 2 + (y - found[j, 1]) ** 2)
        if nearest < near_m * near_m:
            there += 1
            continue
        bearing, i = math.atan2(y - origin[1], x - origin[0]), 0
        while i < len(bearings) and bearings[i] < bearing:
            i += 1
        i, range_m = min(max(i, 1), len(bearings) - 1), np.inf
        for j in (i - 1, i):
            range_m = min(range_m, math.hypot(found[j, 0] - origin[0], found[j, 1] - origin[1]))
        gone += range_m > math.hypot(x - origin[0], y - origin[1]) + behind_m
    return there, gone
