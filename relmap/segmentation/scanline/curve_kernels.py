"""Curves that are cut into straight pieces, compiled; see `relmap.segmentation.scanline.lines`."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.segmentation.wall import BEGIN, END, PX, PY, UX, UY

BOWED, EXPLAINED = 2.0, 0.4
"""Bow of the pieces of a curve, in standard deviations, and allowed difference between turn and
bow."""
NEXT = 2
"""Largest difference of point numbers between the end of a piece and the start of the next."""


@helper
def _swing(wall: Floats, xy: Floats, own: Ints, sigma: float) -> float:
    """Return the turn of a wall from its middle to its end, radians; 0 if uncertain."""
    n, mean, squares, cubes = len(own), 0.0, 0.0, 0.0
    place, off = np.empty(n), np.empty(n)
    for i in range(n):
        x, y = xy[own[i], 0] - wall[PX], xy[own[i], 1] - wall[PY]
        place[i], off[i] = x * wall[UX] + y * wall[UY], y * wall[UX] - x * wall[UY]
        mean += place[i] / n
    for i in range(n):
        place[i] -= mean
        squares += place[i] ** 2
        cubes += place[i] ** 3
    # Difference between a parabola and its line, and the part of it in the residuals.
    bow, weight = 0.0, 0.0
    for i in range(n):
        bend = place[i] ** 2 - cubes / squares * place[i] - squares / n
        bow += off[i] * bend
        weight += bend**2
    weight = max(weight, 1e-12)
    sure = n > 3 and abs(bow / weight) > BOWED * sigma / math.sqrt(weight)
    return bow / weight * (wall[END] - wall[BEGIN]) if sure else 0.0


@compiled
def curved_ends(walls: Floats, xy: Floats, labels: Ints, bounds: Ints, sigma: float) -> Bools:
    """Return which ends (k, 2) of walls are not corners because the surface continues as a curve.

    `bounds` (2, k): first and last point of each wall; `sigma`: noise, metres.
    """
    curved, swing = np.zeros((len(walls), 2), dtype=np.bool_), 0.0
    own = np.empty(len(xy), dtype=np.int64)
    for k in range(len(walls)):
        n, before = 0, swing
        for i in range(bounds[0, k], bounds[1, k] + 1):
            if labels[i] == k:
                own[n] = i
                n += 1
        swing = _swing(walls[k], xy, own[:n], sigma)
        if k > 0 and bounds[0, k] - bounds[1, k - 1] <= NEXT:
            vx, vy, ux, uy = walls[k, UX], walls[k, UY], walls[k - 1, UX], walls[k - 1, UY]
            turn = math.atan2(ux * vy - uy * vx, ux * vx + uy * vy)
            explained = abs(turn - before - swing) < EXPLAINED * abs(turn)
            if before * turn > 0 and swing * turn > 0 and explained:
                curved[k, 0] = curved[k - 1, 1] = True
    return curved
