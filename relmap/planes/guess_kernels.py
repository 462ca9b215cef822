"""Motions that walls and corners of two scans imply, compiled.

`tracks` and `seen` are as `relmap.planes.matching_kernels` has them; a motion is yaw, x, y.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import ordered
from relmap.planes.matching_kernels import Seen, Tracks, half_turn

USUAL_RAD = np.deg2rad(60.0)
"""By how much a turn differs from the one before, about."""
ALIKE_RAD = np.deg2rad(3.0)
"""Turns that differ by less tell the same motion."""
PARALLEL_RAD = np.deg2rad(6.0)
"""How far two walls may be from parallel and yet be the same."""
CROSSING = np.sin(np.deg2rad(25.0))
"""Walls that cross by less do not fix a place."""
CELL_M = 0.08
"""Motions of one turn that differ by less are one guess."""
LINES = 40
"""Longest pairs of walls, of one turn, that ways are computed from."""
MOST = 1000
"""Ways of one turn that are looked at."""
AGREE_M = 0.15
"""A wall that is off by less agrees with a way."""


@helper
def _turned(tracks: Tracks, seen: Seen, reach_m: float, reach_rad: float) -> tuple[Floats, Floats]:
    """Return the turn of each track into each wall, and the length that tells it; (n, m) each."""
    angle, offset, ends, _, _ = tracks
    wall_ends, _, normal, size, _, _ = seen
    n, m = len(angle), len(size)
    turn, weight = np.zeros((n, m)), np.zeros((n, m))
    for i in range(n):
        own = math.hypot(ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1])
        for j in range(m):
            turn[i, j] = half_turn(math.atan2(normal[j, 1], normal[j, 0]) - angle[i])
            x, y = wall_ends[j, 0, 0], wall_ends[j, 0, 1]
            moved = normal[j, 0] * x + normal[j, 1] * y - offset[i]
            if abs(turn[i, j]) < reach_rad and abs(moved) < reach_m:
                weight[i, j] = min(own, size[j])
    return turn, weight


@helper
def _support(turn: Floats, weight: Floats, chosen: float) -> tuple[float, float]:
    """Return how much of the walls' length is parallel after a turn, and by how much it is off.

    Each wall seen counts once, for the longest track that is parallel to it then.
    """
    total, off_total = 0.0, 0.0
    for j in range(turn.shape[1]):
        best, off_best = 0.0, 0.0
        for i in range(turn.shape[0]):
            off = half_turn(turn[i, j] - chosen)
            near = weight[i, j] * max(1 - (off / ALIKE_RAD) ** 2, 0.0)
            if near > best:
                best, off_best = near, off
        total += best
        off_total += best * off_best
    return total, off_total / max(total, 1e-12)


@helper
def turns(
    tracks: Tracks, seen: Seen, before: float, reach_m: float, reach_rad: float, most: int
) -> Floats:
    """Return the turns that bring most of the walls' length to be parallel, best first; (k,).

    The nearer a turn is to the one before, the more it counts.
    """
    turn, weight = _turned(tracks, seen, reach_m, reach_rad)
    every, mean, size = turn.ravel(), turn.ravel().copy(), weight.ravel()
    support = np.zeros(len(every))
    for k in range(len(every)):
        if size[k] > 0:
            total, off = _support(turn, weight, every[k])
            mean[k] += off
            unusual = half_turn(every[k] - before) / USUAL_RAD
            support[k] = total * math.exp(-0.5 * unusual**2)
    found, count = np.empty(most), 0
    while count < most:
        k = -1
        for q in range(len(every)):
            if support[q] > 0 and (k < 0 or support[q] > support[k]):
                k = q
        if k < 0:
            break
        found[count], count = mean[k], count + 1
        for q in range(len(every)):
            if abs(half_turn(every[q] - every[k])) < 2 * ALIKE_RAD:
                support[q] = 0.0
    return found[:count]


@helper
def _lines(tracks: Tracks, seen: Seen, yaw: float, reach_m: float) -> Floats:
    """Return what pairs of parallel walls say of the way: normal, distance and size; (k, 4)."""
    angle, _, ends, _, _ = tracks
    wall_ends, _, normal, size, _, _ = seen
    n, m = len(angle), len(size)
    weight, told = np.empty(n * m), np.empty((n * m, 4))
    count = 0
    for i in range(n):
        own = math.hypot(ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1])
        x, y = (ends[i, 0, 0] + ends[i, 1, 0]) / 2, (ends[i, 0, 1] + ends[i, 1, 1]) / 2
        c, s = math.cos(yaw), math.sin(yaw)
        x, y = c * x - s * y, s * x + c * y
        for j in range(m):
            turn = math.atan2(normal[j, 1], normal[j, 0]) - angle[i] - yaw
            if abs(half_turn(turn)) >= PARALLEL_RAD:
                continue
            nx, ny = normal[j, 0], normal[j, 1]
            at = nx * wall_ends[j, 0, 0] + ny * wall_ends[j, 0, 1]
            way = at - nx * x - ny * y
            if abs(way) < reach_m:
                weight[count] = -min(own, size[j])
                told[count, 0], told[count, 1], told[count, 2] = nx, ny, way
                told[count, 3] = -weight[count]
                count += 1
    return _rows(told, ordered(weight[:count]), LINES)


@helper
def _rows(of: Floats, which: Ints, most: int) -> Floats:
    """Return the first rows of those chosen (k,)."""
    found = np.empty((min(len(which), most), of.shape[1]))
    for i in range(len(found)):
        for k in range(of.shape[1]):
            found[i, k] = of[which[i], k]
    return found


@helper
def _noted(found: Floats, count: int, x: float, y: float, reach_m: float, taken: Bools) -> int:
    """Note a way that is within reach and not noted yet; return how many there are."""
    if not math.hypot(x, y) < reach_m or count == len(found):
        return count
    i, j = int((x + reach_m) / CELL_M), int((y + reach_m) / CELL_M)
    if taken[i, j]:
        return count
    taken[i, j] = True
    found[count, 0], found[count, 1] = x, y
    return count + 1


@helper
def _corners(
    tracks: Tracks, seen: Seen, yaw: float, reach_m: float, found: Floats, taken: Bools
) -> int:
    """Note the ways of one turn that bring a corner onto a corner; return how many there are."""
    angle, _, _, _, corner_at = tracks
    wall_ends, _, normal, _, _, static = seen
    c, s, count = math.cos(yaw), math.sin(yaw), 0
    for i in range(len(angle)):
        for j in range(len(static)):
            turn = math.atan2(normal[j, 1], normal[j, 0]) - angle[i] - yaw
            if abs(half_turn(turn)) >= PARALLEL_RAD:
                continue
            for e in range(2):
                a, b = corner_at[i, e, 0], corner_at[i, e, 1]
                x, y = wall_ends[j, e, 0] - c * a + s * b, wall_ends[j, e, 1] - s * a - c * b
                if static[j, e]:  # of a track without that corner x and y are NaN
                    count = _noted(found, count, x, y, reach_m, taken)
    return count


@helper
def _places(tracks: Tracks, seen: Seen, yaw: float, reach_m: float) -> Floats:
    """Return the ways (k, 2) of one turn that corners, and walls that cross, imply.

    And to go at right angles to each wall.  Those that most of the walls agree with, by length,
    come first.
    """
    cells = np.int64(2 * math.ceil(reach_m / CELL_M) + 1)
    taken = np.zeros((cells, cells), dtype=np.bool_)
    lines, found = _lines(tracks, seen, yaw, reach_m), np.empty((MOST, 2))
    across, way, size = lines[:, :2], lines[:, 2], lines[:, 3]
    count = _corners(tracks, seen, yaw, reach_m, found, taken)
    for p in range(len(way)):
        x, y = way[p] * across[p, 0], way[p] * across[p, 1]
        count = _noted(found, count, x, y, reach_m, taken)
        for q in range(p):
            det = across[p, 0] * across[q, 1] - across[p, 1] * across[q, 0]
            if abs(det) > CROSSING:
                x = (way[p] * across[q, 1] - way[q] * across[p, 1]) / det
                y = (way[q] * across[p, 0] - way[p] * across[q, 0]) / det
                count = _noted(found, count, x, y, reach_m, taken)
    against = np.zeros(count)
    for k in range(count):
        for p in range(len(way)):
            off = across[p, 0] * found[k, 0] + across[p, 1] * found[k, 1] - way[p]
            against[k] -= size[p] * max(1 - (off / AGREE_M) ** 2, 0.0)
    return _rows(found, ordered(against), count)


@compiled
def implied(
    tracks: Tracks,
    seen: Seen,
    before: float,
    reach_m: float,
    reach_rad: float,
    n_turns: int,
    each: int,
) -> Floats:
    """Return the motions (k, 3) that walls and corners of a scan imply: so many of each turn."""
    motions, count = np.empty((n_turns * each, 3)), 0
    for yaw in turns(tracks, seen, before, reach_m, reach_rad, n_turns):
        ways = _places(tracks, seen, yaw, reach_m)
        for k in range(min(len(ways), each)):
            motions[count, 0] = yaw
            motions[count, 1], motions[count, 2] = ways[k, 0], ways[k, 1]
            count += 1
    return motions[:count]
