"""Motions that walls and corners of two scans imply, compiled.

`tracks` and `seen` are as `relmap.planes.matching_kernels` has them; a motion is yaw, x, y.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled
from relmap.planes.matching_kernels import Seen, Tracks, _half_turn

Array = NDArray[np.float64]

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


@compiled
def turns(
    tracks: Tracks, seen: Seen, before: float, reach_m: float, reach_rad: float, most: int
) -> Array:
    """Return the turns that bring most of the walls' length to be parallel, best first; (k,).

    Each wall seen counts once, for the longest track that is parallel to it then; the more, the
    nearer the turn is to the one before.
    """
    angle, offset, ends, _, _ = tracks
    wall_ends, _, normal, size, _, _ = seen
    n, m = len(angle), len(size)
    turn, weight = np.zeros(n * m), np.zeros(n * m)
    for i in range(n):
        own = math.hypot(ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1])
        for j in range(m):
            k = i * m + j
            turn[k] = _half_turn(math.atan2(normal[j, 1], normal[j, 0]) - angle[i])
            x, y = wall_ends[j, 0]
            moved = normal[j, 0] * x + normal[j, 1] * y - offset[i]
            if abs(turn[k]) < reach_rad and abs(moved) < reach_m:
                weight[k] = min(own, size[j])
    support, mean = np.zeros(n * m), np.zeros(n * m)
    for k in range(n * m):
        if weight[k] == 0:
            continue
        pulled = 0.0
        for j in range(m):
            best, off_best = 0.0, 0.0
            for i in range(n):
                off = _half_turn(turn[i * m + j] - turn[k])
                near = weight[i * m + j] * max(1 - (off / ALIKE_RAD) ** 2, 0.0)
                if near > best:
                    best, off_best = near, off
            support[k] += best
            pulled += best * off_best
        mean[k] = turn[k] + pulled / support[k]
        support[k] *= math.exp(-0.5 * (_half_turn(turn[k] - before) / USUAL_RAD) ** 2)
    found, count = np.empty(most), 0
    while count < most and n * m:
        k = np.argmax(support)
        if support[k] <= 0:
            break
        found[count], count = mean[k], count + 1
        for q in range(n * m):
            if abs(_half_turn(turn[q] - turn[k])) < 2 * ALIKE_RAD:
                support[q] = 0.0
    return found[:count]


@compiled
def _lines(tracks: Tracks, seen: Seen, yaw: float, reach_m: float) -> tuple[Array, Array, Array]:
    """Return what pairs of parallel walls say of the way: normal (k, 2), distance (k,), size (k,)."""
    angle, offset, ends, _, _ = tracks
    wall_ends, _, normal, size, _, _ = seen
    n, m = len(angle), len(size)
    weight, told = np.empty(n * m), np.empty((n * m, 3))
    count = 0
    for i in range(n):
        own = math.hypot(ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1])
        x, y = (ends[i, 0, 0] + ends[i, 1, 0]) / 2, (ends[i, 0, 1] + ends[i, 1, 1]) / 2
        c, s = math.cos(yaw), math.sin(yaw)
        x, y = c * x - s * y, s * x + c * y
        for j in range(m):
            turn = math.atan2(normal[j, 1], normal[j, 0]) - angle[i] - yaw
            if abs(_half_turn(turn)) >= PARALLEL_RAD:
                continue
            nx, ny = normal[j]
            at = nx * wall_ends[j, 0, 0] + ny * wall_ends[j, 0, 1]
            way = at - nx * x - ny * y
            if abs(way) < reach_m:
                weight[count] = -min(own, size[j])
                told[count, 0], told[count, 1], told[count, 2] = nx, ny, way
                count += 1
    order = np.argsort(weight[:count])[:LINES]
    return told[order, :2], told[order, 2], -weight[order]


@compiled
def _places(tracks: Tracks, seen: Seen, yaw: float, reach_m: float) -> Array:
    """Return the ways (k, 2) of one turn that corners, and walls that cross, imply.

    And to go at right angles to each wall.  Those that most of the walls agree with, by length,
    come first.
    """
    angle, _, _, _, corner_at = tracks
    wall_ends, _, normal, _, _, static = seen
    c, s = math.cos(yaw), math.sin(yaw)
    cells = np.int64(2 * math.ceil(reach_m / CELL_M) + 1)
    taken = np.zeros((cells, cells), dtype=np.bool_)
    across, way, size = _lines(tracks, seen, yaw, reach_m)
    found, count = np.empty((MOST, 2)), 0
    for i in range(len(angle)):
        for j in range(len(static)):
            turn = math.atan2(normal[j, 1], normal[j, 0]) - angle[i] - yaw
            if abs(_half_turn(turn)) >= PARALLEL_RAD:
                continue
            for e in range(2):
                a, b = corner_at[i, e]
                x, y = wall_ends[j, e, 0] - c * a + s * b, wall_ends[j, e, 1] - s * a - c * b
                if static[j, e]:  # of a track without that corner x and y are NaN
                    count = _noted(found, count, x, y, reach_m, taken)
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
    return found[np.argsort(against)]


@compiled
def _noted(
    found: Array, count: int, x: float, y: float, reach_m: float, taken: NDArray[np.bool_]
) -> int:
    """Note a way that is within reach and not noted yet; return how many there are."""
    if not math.hypot(x, y) < reach_m or count == len(found):
        return count
    i, j = int((x + reach_m) / CELL_M), int((y + reach_m) / CELL_M)
    if taken[i, j]:
        return count
    taken[i, j] = True
    found[count, 0], found[count, 1] = x, y
    return count + 1


@compiled
def implied(
    tracks: Tracks,
    seen: Seen,
    before: float,
    reach_m: float,
    reach_rad: float,
    n_turns: int,
    each: int,
) -> Array:
    """Return the motions (k, 3) that walls and corners of a scan imply: so many of each turn."""
    motions, count = np.empty((n_turns * each, 3)), 0
    for yaw in turns(tracks, seen, before, reach_m, reach_rad, n_turns):
        ways = _places(tracks, seen, yaw, reach_m)
        for k in range(min(len(ways), each)):
            motions[count, 0] = yaw
            motions[count, 1], motions[count, 2] = ways[k]
            count += 1
    return motions[:count]
