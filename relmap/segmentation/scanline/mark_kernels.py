"""Compiled: specks, beams that end in front of a surface, and curves cut into straight pieces."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import median
from relmap.segmentation.scanline.beam_kernels import OFF, SKIPPED, STRAYS, breaks, radii, turns
from relmap.segmentation.wall import BEGIN, END, PX, PY, UX, UY

EVEN = 1.5
"""Factor by which points on a surface may be farther apart than the nearer of the adjacent ones."""
BESIDE = 3
"""Number of neighbours on either side used to detect a speck; more than half of those farther away
must be collinear."""


@helper
def _goes_on(xy: Floats, i: int, j: int, sigma: float) -> bool:
    """Return whether two points are no farther apart than the beams between them account for."""
    gap = math.hypot(xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1])
    a, b = max(i - 1, 0), min(j + 1, len(xy) - 1)
    before = math.hypot(xy[i, 0] - xy[a, 0], xy[i, 1] - xy[a, 1])
    after = math.hypot(xy[b, 0] - xy[j, 0], xy[b, 1] - xy[j, 1])
    return bool(gap <= EVEN * (j - i) * min(before, after) + 6 * sigma)


@helper
def _close_specks(xy: Floats, sigma: float, found: Bools) -> None:
    """Mark points (n,) slightly in front of the line through their neighbours on both sides."""
    own, n = np.empty(len(found), dtype=np.int64), 0
    for i in range(len(found)):
        if not found[i]:
            own[n] = i
            n += 1
    for k in range(BESIDE, n - BESIDE):
        i, a, b = own[k], own[k - 1], own[k + 1]
        dx, dy = xy[b, 0] - xy[a, 0], xy[b, 1] - xy[a, 1]
        length = max(math.hypot(dx, dy), 1e-12)
        side = (dx * xy[a, 1] - dy * xy[a, 0]) / length  # away from the sensor
        off = (dx * (xy[i, 1] - xy[a, 1]) - dy * (xy[i, 0] - xy[a, 0])) / length
        if off * side >= 0 or abs(off) <= OFF * sigma:
            continue
        on_line = 0
        for m in range(2, BESIDE + 1):
            for at in range(k - m, k + m + 1, 2 * m):
                j = own[at]
                off = (dx * (xy[j, 1] - xy[a, 1]) - dy * (xy[j, 0] - xy[a, 0])) / length
                on_line += abs(off) <= OFF * sigma
        found[i] = on_line > BESIDE - 1


@compiled
def specks_and_breaks(xy: Floats, sigma: float) -> tuple[Bools, Bools]:
    """Return which points (n,) are specks in front of a surface that continues beside them.

    Also returns after which points the next beam hits something else.
    """
    n, found = len(xy), np.zeros(len(xy), dtype=np.bool_)
    if n < 3:
        return found, found.copy()
    turn, radius = turns(xy), radii(xy)
    broken, usual, i = breaks(xy, turn, turn, sigma), median(turn.copy()), 0
    while i < n - 1:
        j, wide = i + 1, turn[i]
        if broken[i]:
            while j < n - 1 and j - i <= STRAYS and radius[j] < radius[i]:
                wide += turn[j]
                j += 1
                hidden = wide < (j - i + 1) * usual and radius[j - 1] < radius[j]
                if hidden and _goes_on(xy, i, j, sigma):
                    for k in range(i + 1, j):
                        found[k] = True
                    break
            else:
                j = i + 1
        i = j
    _close_specks(xy, sigma, found)
    for i in range(n - 1):
        broken[i] = broken[i] and turn[i] < SKIPPED * usual
    return found, broken


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
