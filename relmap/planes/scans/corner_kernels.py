"""The static points that walls show, and the four midpoint pairs of Fig. 4, compiled.

See `relmap.planes.model` and `relmap.planes.scans.corners`.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper

FEWEST = 8
"""Minimum number of common iterations."""
SKEW = 0.5
"""Sine of the smallest usable angle between two walls: for smaller ones, two ends cut by the view
move together while the robot goes straight."""
MOVED_M = 0.5
"""Minimum motion of one of two ends, as seen by the robot, for a steady pair to be static."""
NOISY_M = 0.05
"""A pair with a larger deviation due to noise alone is not informative."""
EXACT_M = 0.01
"""Deviations below this count as zero."""
BLUNT = 3.0
"""Ratio of the standard deviation of an end along its wall to that across it."""


@compiled
def midpoint_pairs(first: Floats, second: Floats, size: float, other_size: float) -> Floats:
    """Return the four pairs of estimated midpoints in each iteration (k, 2, 2, 2), metres.

    From the first wall's midpoint, estimated from its right or left end, to the second's, likewise;
    the first wall's normal is along x.
    """
    pairs = np.empty((len(first), 2, 2, 2))
    for k in range(len(first)):
        x, y = first[k, 1, 0] - first[k, 0, 0], first[k, 1, 1] - first[k, 0, 1]
        length = math.hypot(x, y)
        ux, uy = x / length, y / length
        x, y = second[k, 1, 0] - second[k, 0, 0], second[k, 1, 1] - second[k, 0, 1]
        length = math.hypot(x, y)
        vx, vy = x / length, y / length
        for i in range(2):
            inwards = size / 2 if i == 0 else -size / 2
            mid_x, mid_y = first[k, i, 0] + inwards * ux, first[k, i, 1] + inwards * uy
            for j in range(2):
                inwards = other_size / 2 if j == 0 else -other_size / 2
                apart_x = second[k, j, 0] + inwards * vx - mid_x
                apart_y = second[k, j, 1] + inwards * vy - mid_y
                # The first wall's normal is (-uy, ux).
                pairs[k, i, j, 0] = -uy * apart_x + ux * apart_y
                pairs[k, i, j, 1] = -ux * apart_x - uy * apart_y
    return pairs


@helper
def largest(ends: Floats) -> float:
    """Return the largest size of a wall in some iterations, of its ends (k, 2, 2)."""
    size = 0.0
    for k in range(len(ends)):
        size = max(size, math.hypot(ends[k, 1, 0] - ends[k, 0, 0], ends[k, 1, 1] - ends[k, 0, 1]))
    return size


@compiled
def deviations(pairs: Floats) -> Floats:
    """Return the standard deviation (2, 2) of each of four pairs (k, 2, 2, 2), metres."""
    k, found = len(pairs), np.empty((2, 2))
    for i in range(2):
        for j in range(2):
            total = 0.0
            for a in range(2):
                mean = 0.0
                for n in range(k):
                    mean += pairs[n, i, j, a] / k
                for n in range(k):
                    total += (pairs[n, i, j, a] - mean) ** 2
            found[i, j] = math.sqrt(total / k)
    return found


@helper
def _skew(first: Floats, second: Floats) -> float:
    """Return the sine of the angle between two walls, in the middle iteration."""
    k = len(first) // 2
    x, y = first[k, 1, 0] - first[k, 0, 0], first[k, 1, 1] - first[k, 0, 1]
    v, w = second[k, 1, 0] - second[k, 0, 0], second[k, 1, 1] - second[k, 0, 1]
    return float(abs(x * w - y * v) / (math.hypot(x, y) * math.hypot(v, w)))


@helper
def _moved(ends: Floats, e: int) -> float:
    """Return the largest displacement of one end (k, 2, 2) from its first position; robot frame."""
    farthest = 0.0
    for k in range(len(ends)):
        away = math.hypot(ends[k, e, 0] - ends[0, e, 0], ends[k, e, 1] - ends[0, e, 1])
        farthest = max(farthest, away)
    return farthest


@helper
def _expected(first: Floats, second: Floats, size: float, sd: float, other_sd: float) -> float:
    """Return the deviation of a pair of corners due to noise: of both ends, and of the rotation."""
    k = len(first) // 2
    x = (second[k, 0, 0] + second[k, 1, 0] - first[k, 0, 0] - first[k, 1, 0]) / 2
    y = (second[k, 0, 1] + second[k, 1, 1] - first[k, 0, 1] - first[k, 1, 1]) / 2
    turned = math.sqrt(12.0) * math.hypot(x, y) * sd / size
    return float(math.sqrt((BLUNT * sd) ** 2 + (BLUNT * other_sd) ** 2 + turned**2))


@helper
def _common(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Return the ends of two walls (k, 2, 2) in their common iterations."""
    n, at = 0, np.empty(len(first), dtype=np.int64)
    for k in range(len(first)):
        if not (math.isnan(first[k, 0, 0]) or math.isnan(second[k, 0, 0])):
            at[n] = k
            n += 1
    return first[at[:n]], second[at[:n]]


@compiled
def relative_deviations(block: Floats, sd: Floats, wall: int) -> tuple[Floats, Floats]:
    """Compare a wall with all others that it was seen with.

    `block` (w, k, 2, 2), robot frame, metres: ends of walls in the iterations of an interval; NaN
    where missing. `sd` (w,), metres: standard deviations of the distances of the walls. Returns
    `deviation` (w, 2, 2), metres: for the four pairs with each wall; infinite if not informative.
    `expected` (w,), metres: deviation due to noise alone.
    """
    n = len(block)
    found, by_noise = np.full((n, 2, 2), np.inf), np.full(n, np.inf)
    for other in range(n):
        first, second = _common(block[wall], block[other])
        if len(first) < FEWEST or other == wall:
            continue
        size, other_size = largest(first), largest(second)
        # The rotation of the longer wall is less noisy: it defines 0 degrees.
        if size >= other_size:
            expected = _expected(first, second, size, sd[wall], sd[other])
            spread = deviations(midpoint_pairs(first, second, size, other_size))
        else:
            expected = _expected(second, first, other_size, sd[other], sd[wall])
            spread = deviations(midpoint_pairs(second, first, other_size, size)).T
        if _skew(first, second) < SKEW or expected > NOISY_M:
            continue
        for i in range(2):
            for j in range(2):
                if max(_moved(first, i), _moved(second, j)) >= MOVED_M:
                    found[other, i, j] = spread[i, j]
                    by_noise[other] = max(expected, EXACT_M)
    return found, by_noise


@compiled
def corners_and_midpoints(
    landmark: Ints, corner: Ints, ends: Floats, half: Floats
) -> tuple[Ints, Floats, Ints]:
    """Return the corners of walls, and their estimated midpoints (Fig. 4).

    `landmark`, `corner` (n, 2): landmark and corner at either end of each wall; -1 for none. `ends`
    (n, 2, 2), robot frame, metres. `half` (c,), metres: half the fixed size of the wall of each
    corner. Returns `landmarks` (k,), `points_robot` (k, 2): corners and midpoints alternate and
    `per_row` (n,).
    """
    k, per_row = 0, np.zeros(len(landmark), dtype=np.int64)
    for i in range(len(landmark)):
        for e in range(2):
            if landmark[i, e] >= 0:
                per_row[i] += 2
        k += per_row[i]
    landmarks, points = np.empty(k, dtype=np.int64), np.empty((k, 2))
    k = 0
    for i in range(len(landmark)):
        x, y = ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1]
        size = math.hypot(x, y)
        for e in range(2):
            if landmark[i, e] < 0:
                continue
            inwards = half[corner[i, e]] if e == 0 else -half[corner[i, e]]
            landmarks[k], landmarks[k + 1] = landmark[i, e], 2 * corner[i, e] + 1
            points[k, 0], points[k, 1] = ends[i, e, 0], ends[i, e, 1]
            points[k + 1, 0] = ends[i, e, 0] + inwards * (x / size)
            points[k + 1, 1] = ends[i, e, 1] + inwards * (y / size)
            k += 2
    return landmarks, points, per_row
