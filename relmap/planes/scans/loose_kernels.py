"""Which points of a scan are on walls, on small free-standing objects, or seen again, compiled.

Points are in the robot frame, sorted by their bearings from the sensor.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.linalg.compiling import compiled, helper, unrolled
from relmap.planes.scans.beams import NEAR_M

UNSEEN_RAD = 0.1
"""Bearings farther apart than this are outside the field of view."""
LOOSE_M = 0.7
"""Largest size of what may be a person."""
APART_M, APART = 0.2, 0.05
"""Distance of neighbouring points on different objects: constant, and as a fraction of the range of
the nearer one."""
STAYS_M, BEHIND_M = 0.2, 0.4
"""An object is still there if a point was seen nearer than this, and gone if a beam ended farther
behind it."""


@compiled
def on_walls(points: Floats, ends: Floats, near_m: float) -> Bools:
    """Return which points (n, 2) lie on walls, given their ends (m, 2, 2)."""
    solid = np.zeros(len(points), dtype=np.bool_)
    for j in range(len(ends)):
        ax, ay = ends[j, 0, 0], ends[j, 0, 1]
        ux, uy = ends[j, 1, 0] - ax, ends[j, 1, 1] - ay
        size = math.hypot(ux, uy)
        for k in range(len(points)):
            x, y = points[k, 0] - ax, points[k, 1] - ay
            along = (x * ux + y * uy) / size
            if abs(x * uy - y * ux) / size < near_m and -near_m < along < size + near_m:
                solid[k] = True
    return solid


@helper
def _extent(points: Floats, first: int, last: int) -> float:
    """Return the diagonal of the box around points first to last."""
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for k in range(first, last + 1):
        low_x, high_x = min(low_x, points[k, 0]), max(high_x, points[k, 0])
        low_y, high_y = min(low_y, points[k, 1]), max(high_y, points[k, 1])
    return math.hypot(high_x - low_x, high_y - low_y)


@helper
def _is_behind(seen: tuple[Floats, Floats, Floats], k: int, other: int) -> bool:
    """Return whether a neighbour of a point is farther from the sensor, or was not seen."""
    points, bearings, origin = seen
    if other < 0 or other >= len(points):
        return False
    own_m = math.hypot(points[k, 0] - origin[0], points[k, 1] - origin[1])
    other_m = math.hypot(points[other, 0] - origin[0], points[other, 1] - origin[1])
    return bool(other_m > own_m or abs(bearings[other] - bearings[k]) > UNSEEN_RAD)


@compiled
def free_standing(points: Floats, bearings: Floats, origin: Floats) -> Bools:
    """Return which points (n,) are on small objects with something behind them on both sides.

    On one side, another such object may be in front instead.
    """
    found = np.zeros(len(points), dtype=np.bool_)
    seen, starts = (points, bearings, origin), _starts(points, origin)
    _mark_free(seen, starts, found.copy(), found)
    _mark_free(seen, starts, found.copy(), found)
    return found


@helper
def _starts(points: Floats, origin: Floats) -> Bools:
    """Return which points (n,) are on another object than the one before."""
    starts, before_m = np.zeros(len(points), dtype=np.bool_), 0.0
    for k in range(len(points)):
        x, y = points[k, 0] - origin[0], points[k, 1] - origin[1]
        range_m = math.sqrt(x * x + y * y)  # `hypot` takes four times as long
        if k > 0:
            x, y = points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1]
            apart = math.sqrt(x * x + y * y)
            starts[k] = not apart <= APART_M + APART * min(before_m, range_m)
        before_m = range_m
    return starts


@compiled
def isolated_points(points: Floats, bearings: Floats, origin: Floats) -> Bools:
    """Return which points (n,) are apart from those before and after them, and nearer."""
    found, seen = _starts(points, origin), (points, bearings, origin)
    for k in range(len(points)):
        if found[k]:  # few are
            found[k] = k + 1 < len(points) and found[k + 1]
            found[k] &= _is_behind(seen, k, k - 1) and _is_behind(seen, k, k + 1)
    return found


@helper
def _mark_free(
    seen: tuple[Floats, Floats, Floats], starts: Bools, known: Bools, found: Bools
) -> None:
    """Mark the points on small objects with something behind them, or a known one on one side."""
    points = seen[0]
    n, first = len(points), 0
    for k in range(1, n + 1):
        if k < n and not starts[k]:
            continue
        right, left = _is_behind(seen, first, first - 1), _is_behind(seen, k - 1, k)
        free = (
            (right and left)
            or (right and k < n and known[k])
            or (left and first > 0 and known[first - 1])
        )
        if free and _extent(points, first, k - 1) <= LOOSE_M:
            found[first:k] = True
        first = k


@compiled
def loose_walls(points: Floats, loose: Bools, ends: Floats) -> Bools:
    """Return which walls, given their ends (m, 2, 2), lie on free-standing objects."""
    found = np.zeros(len(ends), dtype=np.bool_)
    for j in range(len(ends)):
        x, y = ends[j, 1, 0] - ends[j, 0, 0], ends[j, 1, 1] - ends[j, 0, 1]
        if math.hypot(x, y) > LOOSE_M:
            continue
        on, of_those = 0, 0
        for k, is_on in enumerate(on_walls(points, ends[j : j + 1], NEAR_M)):
            on += is_on
            of_those += is_on and loose[k]
        found[j] = 2 * of_those > on
    return found


@unrolled
def seen_again(
    points: Floats, later: tuple[Floats, Floats, Floats], motion: Floats
) -> tuple[int, int]:
    """Return how many points (n, 2), moved into the frame of a later scan, are there, and gone.

    A scan is its points (m, 2), their bearings (m,), ascending, and the place of the sensor (2,).
    A point is there if one was seen near it, and otherwise gone if both beams beside it end far
    behind it.
    """
    found, bearings, origin = later
    c, s, there, gone = math.cos(motion[0]), math.sin(motion[0]), 0, 0
    for k in range(len(points)):
        x = c * points[k, 0] - s * points[k, 1] + motion[1]
        y = s * points[k, 0] + c * points[k, 1] + motion[2]
        nearest = np.inf
        for j in range(len(found)):
            nearest = min(nearest, (x - found[j, 0]) ** 2 + (y - found[j, 1]) ** 2)
        if nearest < STAYS_M * STAYS_M:
            there += 1
            continue
        bearing, i = math.atan2(y - origin[1], x - origin[0]), 0
        while i < len(bearings) and bearings[i] < bearing:
            i += 1
        i, range_m = min(max(i, 1), len(bearings) - 1), np.inf
        for j in (i - 1, i):
            range_m = min(range_m, math.hypot(found[j, 0] - origin[0], found[j, 1] - origin[1]))
        gone += range_m > math.hypot(x - origin[0], y - origin[1]) + BEHIND_M
    return there, gone
