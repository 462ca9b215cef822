"""Agreement of the beams of two scans for a motion between them, compiled.

A scan is `points` (n, 2), robot frame, sorted by their `bearings` (n,) from `origin` (2,), where
the sensor is; `solid` (n,) marks those on walls, and `loose` (n,) those on small free-standing
objects.  A motion is yaw, x, y from the frame of the earlier scan into that of the later one.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.linalg.compiling import compiled, helper

Fan = tuple[Floats, Floats, Floats, Bools, Bools]

BESIDE = 3
"""Number of beams on either side of a point whose surface it is compared with."""
GAP_M, GAP = 0.3, 0.1
"""Beams farther apart than this plus so much of the range do not share a surface."""
GAP_RAD, MISSING = 0.1, 1.5
"""Bearings farther apart than this are outside the field of view; if they are so many times farther
apart than others, a beam is missing, and a gap there may be anything."""
STRAIGHT, FARTHER = 0.05, 4.0
"""Points lie on a line up to this fraction of their distance, and this ratio of distances."""


@helper
def _rank(x: float, y: float) -> float:
    """Return a number that is ordered as the bearings of directions are, -2 to 2, and cheaper."""
    off = y / (abs(x) + abs(y)) if x != 0 or y != 0 else 0.0
    if x >= 0:
        return off
    return 2 - off if y >= 0 else -2 - off


@helper
def _continues(points: Floats, i: int, j: int, k: int) -> bool:
    """Return whether the line through two points passes near a third one, beyond the second."""
    if i < 0 or i >= len(points):
        return False
    ux, uy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    vx, vy = points[k, 0] - points[j, 0], points[k, 1] - points[j, 1]
    size, ahead = math.sqrt(ux * ux + uy * uy), math.sqrt(vx * vx + vy * vy)
    off = abs(ux * vy - uy * vx) / max(size, 1e-9)
    return bool(ux * vx + uy * vy > 0 and off < STRAIGHT * ahead and ahead < FARTHER * size)


@helper
def _is_on_a_line(points: Floats, j: int) -> bool:
    """Return whether a point and the one before lie on a line with a neighbour.

    Then they are on a wall that is seen at a grazing angle.
    """
    return _continues(points, j - 2, j - 1, j) or _continues(points, j + 1, j, j - 1)


@helper
def _surfaces(seen: Fan) -> tuple[Floats, Floats]:
    """Return what lies between each beam and the one before, (n, 6), and the beams' ranks (n,).

    The end of the previous beam, the vector from it to the end of this one, the inverse of its
    squared length or -1 for a gap, and the range of the shorter beam, or -1 out of view.
    """
    points, bearings, origin, _, _ = seen
    found, ranks = np.zeros((len(points), 6)), np.empty(len(points))
    spacing = np.inf
    for j in range(1, len(points)):
        if bearings[j] - bearings[j - 1] > 1e-4:
            spacing = min(spacing, bearings[j] - bearings[j - 1])
    for j in range(len(points)):
        ranks[j] = _rank(points[j, 0] - origin[0], points[j, 1] - origin[1])
    for j in range(1, len(points)):
        ax, ay = points[j - 1, 0], points[j - 1, 1]
        ux, uy = points[j, 0] - ax, points[j, 1] - ay
        length = ux * ux + uy * uy
        gap = length > (GAP_M + GAP * math.sqrt(ax * ax + ay * ay)) ** 2
        found[j, 0], found[j, 1], found[j, 2], found[j, 3] = ax, ay, ux, uy
        found[j, 4] = -1.0 if gap else 1.0 / max(length, 1e-12)
        found[j, 5] = math.sqrt(
            min(
                (points[j, 0] - origin[0]) ** 2 + (points[j, 1] - origin[1]) ** 2,
                (ax - origin[0]) ** 2 + (ay - origin[1]) ** 2,
            )
        )
        apart = bearings[j] - bearings[j - 1]
        missing = apart > MISSING * spacing
        if gap and not missing and _is_on_a_line(points, j):
            found[j, 4] = 1.0 / max(length, 1e-12)
        if apart > GAP_RAD or (gap and missing):
            found[j, 5] = -1.0
    return found, ranks


@helper
def _squared_distance(x: float, y: float, surfaces: Floats, j: int) -> float:
    """Return the squared distance of a point from a surface, or from the ends of a gap."""
    x, y = x - surfaces[j, 0], y - surfaces[j, 1]
    ux, uy, inverse = surfaces[j, 2], surfaces[j, 3], surfaces[j, 4]
    if inverse < 0:
        return float(min(x * x + y * y, (x - ux) ** 2 + (y - uy) ** 2))
    t = min(max((x * ux + y * uy) * inverse, 0.0), 1.0)
    return float((x - t * ux) ** 2 + (y - t * uy) ** 2)


@helper
def _squared_nearest(x: float, y: float, surfaces: Floats, i: int) -> float:
    """Return the squared distance of a point from the nearest surface by a beam."""
    off = np.inf
    for j in range(max(i - BESIDE, 1), min(i + BESIDE + 1, len(surfaces))):
        off = min(off, _squared_distance(x, y, surfaces, j))
    return off


@helper
def _compare(
    seen: Fan,
    drawn: tuple[Floats, Floats],
    other: Fan,
    motion: Floats,
    near_m: float,
    step: int,
    firm: bool,
    sums: Floats,
    values: Floats,
) -> None:
    """Count the points of `other`, transformed into the frame of `seen`, that agree with its beams.

    `sums` are the points on a surface that was seen, the wall points in front of one, where a beam
    passed through, the undecided ones, and those out of view.  Unless empty, `values` are NaN and
    get the contribution of each point: 0.5 to 1, -1 and 0; those out of view stay NaN.
    """
    _, _, origin, _, _ = seen
    surfaces, ranks = drawn
    c, s, n, i = math.cos(motion[0]), math.sin(motion[0]), len(ranks), 0
    for k in range(0, len(other[0]), step):
        if firm and other[4][k]:
            continue
        x = c * other[0][k, 0] - s * other[0][k, 1] + motion[1]
        y = s * other[0][k, 0] + c * other[0][k, 1] + motion[2]
        dx, dy = x - origin[0], y - origin[1]
        rank = _rank(dx, dy)
        while i < n and ranks[i] < rank:  # bearings change slowly from beam to beam
            i += 1
        while i > 0 and ranks[i - 1] >= rank:
            i -= 1
        if i == 0 or i == n or surfaces[i, 5] < 0:
            sums[3] += 1
            continue
        off, kind, value = _squared_nearest(x, y, surfaces, i), 2, 0.0
        if off < near_m * near_m:
            kind, value = 0, 1 - 0.5 * off / (near_m * near_m)
        elif math.sqrt(dx * dx + dy * dy) < surfaces[i, 5] - 2 * near_m:
            kind, value = (1, -1.0) if other[3][k] else (2, 0.0)
        elif firm and seen[4][i] and seen[4][i - 1]:
            kind, value = 3, np.nan
        sums[kind] += value if kind == 0 else 1.0
        if len(values) > 0:
            values[k] = value


@helper
def _inverse(motion: Floats) -> Floats:
    """Return the inverse of a motion (3,)."""
    c, s, back = math.cos(motion[0]), math.sin(motion[0]), np.empty(3)
    back[0] = -motion[0]
    back[1], back[2] = -c * motion[1] - s * motion[2], s * motion[1] - c * motion[2]
    return back


@compiled
def compared(
    earlier: Fan, later: Fan, motions: Floats, near_m: float, step: int, firm: bool
) -> Floats:
    """Return how many points of both scans agree, contradict, are undecided, and out of view.

    Shape (k, 4), for each of k motions; the beams are subsampled.
    """
    sums, none = np.zeros((len(motions), 4)), np.empty(0)
    before, after = _surfaces(earlier), _surfaces(later)
    for k in range(len(motions)):
        motion, back = motions[k], _inverse(motions[k])
        _compare(later, after, earlier, motion, near_m, step, firm, sums[k], none)
        _compare(earlier, before, later, back, near_m, step, firm, sums[k], none)
    return sums


@compiled
def agreement(earlier: Fan, later: Fan, motions: Floats, near_m: float, firm: bool) -> Floats:
    """Return the agreement of each point of both scans, of n and m points: (k, n + m).

    0.5 to 1 if it agrees, -1 if it contradicts, 0 if undecided, NaN if out of view or loose.
    """
    n, sums = len(earlier[0]), np.zeros(4)
    values = np.nan * np.ones((len(motions), n + len(later[0])))
    before, after = _surfaces(earlier), _surfaces(later)
    for k in range(len(motions)):
        motion, back, own = motions[k], _inverse(motions[k]), values[k]
        _compare(later, after, earlier, motion, near_m, 1, firm, sums, own[:n])
        _compare(earlier, before, later, back, near_m, 1, firm, sums, own[n:])
    return values


@compiled
def seen_again(
    points: Floats, later: Fan, motion: Floats, near_m: float, behind_m: float
) -> tuple[int, int]:
    """Return how many points (n, 2), moved into the frame of a later scan, are there, and gone.

    A point is there if one was seen nearer than `near_m`, and otherwise gone if both beams beside
    it end farther behind it than `behind_m`.
    """
    found, bearings, origin, _, _ = later
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
    return bool(other_m > own_m or abs(bearings[other] - bearings[k]) > GAP_RAD)


@compiled
def free_standing(
    points: Floats, bearings: Floats, origin: Floats, size_m: float, gap_m: float, gap: float
) -> Bools:
    """Return which points (n,) are on small objects with something behind them on both sides.

    Neighbours belong to different objects if they are farther apart than `gap_m` and a fraction
    `gap` of the range of the nearer one.  On one side, another such object may be in front instead.
    """
    found = np.zeros(len(points), dtype=np.bool_)
    seen, limits = (points, bearings, origin), (size_m, gap_m, gap)
    _mark_free(seen, limits, found.copy(), found)
    _mark_free(seen, limits, found.copy(), found)
    return found


@helper
def _mark_free(
    seen: tuple[Floats, Floats, Floats],
    limits: tuple[float, float, float],
    known: Bools,
    found: Bools,
) -> None:
    """Mark the points on small objects with something behind them, or a known one on one side."""
    points, _, origin = seen
    size_m, gap_m, gap = limits
    n, first = len(points), 0
    for k in range(1, n + 1):
        if k < n:
            apart = math.hypot(points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1])
            before_m = math.hypot(points[k - 1, 0] - origin[0], points[k - 1, 1] - origin[1])
            range_m = math.hypot(points[k, 0] - origin[0], points[k, 1] - origin[1])
            if apart <= gap_m + gap * min(before_m, range_m):
                continue
        right, left = _is_behind(seen, first, first - 1), _is_behind(seen, k - 1, k)
        free = (
            (right and left)
            or (right and k < n and known[k])
            or (left and first > 0 and known[first - 1])
        )
        if free and _extent(points, first, k - 1) <= size_m:
            found[first:k] = True
        first = k


@compiled
def loose_walls(points: Floats, loose: Bools, ends: Floats, near_m: float, size_m: float) -> Bools:
    """Return which walls, given their ends (m, 2, 2), lie on free-standing objects."""
    found = np.zeros(len(ends), dtype=np.bool_)
    for j in range(len(ends)):
        ax, ay = ends[j, 0, 0], ends[j, 0, 1]
        ux, uy = ends[j, 1, 0] - ax, ends[j, 1, 1] - ay
        size, on, of_those = math.hypot(ux, uy), 0, 0
        if size > size_m:
            continue
        for k in range(len(points)):
            x, y = points[k, 0] - ax, points[k, 1] - ay
            along = (x * ux + y * uy) / size
            if abs(x * uy - y * ux) / size < near_m and -near_m < along < size + near_m:
                on += 1
                of_those += loose[k]
        found[j] = 2 * of_those > on
    return found
