"""Compiled loops over local windows: how thick the walls are, and lines grown from a few points."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper, unrolled
from relmap.segmentation.em.wall_kernels import weighted_line
from relmap.segmentation.wall import BEGIN, END, PX, PY, UX, UY, WALL

ROUNDS = 2
"""Number of alternations between growing a line along its band and fitting it."""
BAND = 2.5
"""Half width, in standard deviations, of the band of a line's own points."""
LEAST = 30
"""Minimum number of points in a window to estimate its thickness."""
IN_A_ROW = 3
ELONGATED = 9.0
"""A window shows a wall where its variance along is this many times that across."""


@unrolled
def window_thickness(xy: Floats, seeds: Ints, radii: Floats) -> Floats:
    """Return the standard deviation across the wall around each seed (s,); NaN if none is visible.

    Discs about the seed grow until two in a row are elongated: smaller ones lie within the noise.
    """
    result, levels = np.empty(len(seeds)), len(radii)
    for s in range(len(seeds)):
        result[s], moments = np.nan, np.zeros((levels, 6))
        x0, y0 = xy[seeds[s], 0], xy[seeds[s], 1]
        for i in range(len(xy)):
            x, y = xy[i, 0] - x0, xy[i, 1] - y0
            square = x * x + y * y
            level = 0
            while level < levels and radii[level] ** 2 < square:
                level += 1
            if level == levels:
                continue
            m = moments[level]
            m[0] += 1
            m[1] += x
            m[2] += y
            m[3] += x * x
            m[4] += x * y
            m[5] += y * y
        total, running = np.zeros(6), 0
        for level in range(levels):
            for k in range(6):
                total[k] += moments[level, k]
            n = total[0]
            if n < LEAST:
                continue
            xx, yy = total[3] - total[1] ** 2 / n, total[5] - total[2] ** 2 / n
            xy_ = total[4] - total[1] * total[2] / n
            half, root = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy_ * xy_)
            running = running + 1 if half + root > ELONGATED * (half - root) else 0
            if running == IN_A_ROW:
                result[s] = math.sqrt(max(half - root, 0.0) / (n - 2))
                break
    return result


@helper
def _filled_run(filled: Bools, cell: int) -> tuple[int, int]:
    """Return the first and last cell of the run about one; single empty cells do not end it."""
    first = last = cell
    while first > 0 and (filled[first - 1] or (first > 1 and filled[first - 2])):
        first -= 1
    n = len(filled)
    while last < n - 1 and (filled[last + 1] or (last < n - 2 and filled[last + 2])):
        last += 1
    return first, last


@helper
def _run_about(xy: Floats, wall: Floats, seed: int, band: float, gap: float, member: Bools) -> int:
    """Mark the points of a line's band connected to the seed, set its ends; return their number."""
    n = len(xy)
    along, inside = np.empty(n), np.zeros(n, dtype=np.bool_)
    lowest, highest = np.inf, -np.inf
    for i in range(n):
        x, y = xy[i, 0] - wall[PX], xy[i, 1] - wall[PY]
        member[i] = False
        if abs(y * wall[UX] - x * wall[UY]) <= band:
            inside[i] = True
            along[i] = x * wall[UX] + y * wall[UY]
            lowest, highest = min(lowest, along[i]), max(highest, along[i])
    if not inside[seed]:
        return 0
    width = max(0.5 * gap, (highest - lowest) / 4096)
    n_bins = int((highest - lowest) / width) + 1
    filled = np.zeros(n_bins, dtype=np.bool_)
    for i in range(n):
        if inside[i]:
            filled[int((along[i] - lowest) / width)] = True
    first, last = _filled_run(filled, int((along[seed] - lowest) / width))
    count, wall[BEGIN], wall[END] = 0, np.inf, -np.inf
    for i in range(n):
        if inside[i]:
            cell = int((along[i] - lowest) / width)
            if first <= cell <= last:
                member[i] = True
                count += 1
                wall[BEGIN], wall[END] = min(wall[BEGIN], along[i]), max(wall[END], along[i])
    return count


@helper
def _angle(wall: Floats) -> float:
    """Return the angle subtended by a wall at the sensor."""
    ax, ay = wall[PX] + wall[BEGIN] * wall[UX], wall[PY] + wall[BEGIN] * wall[UY]
    bx, by = wall[PX] + wall[END] * wall[UX], wall[PY] + wall[END] * wall[UY]
    return abs(math.atan2(ax * by - ay * bx, ax * bx + ay * by))


@helper
def _start_line(xy: Floats, seed: int, chance: float, band: float, window: float, w: Floats) -> int:
    """Fit a line to the window about a seed, through it and a chance neighbour at first.

    Returns the number of points in its band; 0 where the seed has no neighbours.
    """
    n, m = len(xy), 0
    near = np.empty(n, dtype=np.int64)
    for i in range(n):
        x, y = xy[i, 0] - xy[seed, 0], xy[i, 1] - xy[seed, 1]
        if 0 < x * x + y * y < window * window:
            near[m] = i
            m += 1
    if m < 2:
        return 0
    other = near[int(chance * m)]
    w[PX], w[PY] = xy[seed, 0], xy[seed, 1]
    length = math.hypot(xy[other, 0] - w[PX], xy[other, 1] - w[PY])
    w[UX], w[UY] = (xy[other, 0] - w[PX]) / length, (xy[other, 1] - w[PY]) / length
    local, weight, inside = np.empty((m, 2)), np.empty(m), 0
    for i in range(m):
        local[i, 0], local[i, 1] = xy[near[i], 0], xy[near[i], 1]
    for _ in range(ROUNDS):
        inside = 0
        for i in range(m):
            d = (local[i, 1] - w[PY]) * w[UX] - (local[i, 0] - w[PX]) * w[UY]
            weight[i] = 1.0 if abs(d) <= band else 0.0
            inside += 1 if abs(d) <= band else 0
        weighted_line(local, weight, w)
    return inside


@compiled
def grow_lines(
    xy: Floats, chances: Floats, sigma: float, window: float, repeat: float, narrow: float
) -> tuple[Floats, Bools, Floats]:
    """Grow a line from each pair of near points selected by random numbers (tries, 2).

    Of points at one bearing, `repeat` count as one along the line; lines that the sensor sees under
    a `narrow` angle are discarded.

    Returns lines (tries, WALL), their points (tries, n) and scores (tries,): each point counts by
    how near it is (MSAC; Torr and Zisserman, 2000).
    """
    tries, n, band = len(chances), len(xy), BAND * sigma
    walls, members = np.zeros((tries, WALL)), np.zeros((tries, n), dtype=np.bool_)
    scores, weight = np.zeros(tries), np.empty(n)
    for k in range(tries):
        seed, w = int(chances[k, 0] * n), walls[k]
        inside = _start_line(xy, seed, chances[k, 1], band, window, w)
        if inside == 0:
            continue
        gap = max(16 * window * repeat / (inside + 1), sigma)
        for _ in range(ROUNDS):
            if _run_about(xy, w, seed, band, gap, members[k]) < 3:
                break
            for i in range(n):
                weight[i] = 1.0 if members[k, i] else 0.0
            weighted_line(xy, weight, w)
        if _run_about(xy, w, seed, band, gap, members[k]) < 3 or _angle(w) < narrow:
            for i in range(n):
                members[k, i] = False
            continue
        for i in range(n):
            if members[k, i]:
                d = (xy[i, 1] - w[PY]) * w[UX] - (xy[i, 0] - w[PX]) * w[UY]
                scores[k] += 1 - (d / band) ** 2
    return walls, members, scores
