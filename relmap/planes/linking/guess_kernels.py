"""Motions that walls and corners of two scans imply, compiled.

`tracks` and `seen` are as in `relmap.planes.linking.matching_kernels`; a motion is yaw, x, y.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import ordered
from relmap.planes.linking.matching_kernels import Seen, Tracks, half_turn
from relmap.planes.linking.scan_comparison import REACH_M

REACH_RAD = np.deg2rad(120.0)
"""Largest rotation between two scans that are linked."""
TURNS, EACH = 8, 25
"""Number of rotations, and of motions for each."""
USUAL_RAD = np.deg2rad(60.0)
"""Typical rotation."""
ALIKE_RAD = np.deg2rad(3.0)
"""Rotations that differ by less are one hypothesis."""
PARALLEL_RAD = np.deg2rad(6.0)
"""Largest angle between two observations of the same wall."""
CROSSING = np.sin(np.deg2rad(25.0))
"""Walls that cross at a smaller angle do not determine a position."""
CELL_M = 0.08
"""Motions with the same rotation that differ by less are one hypothesis."""
LINES = 40
"""Number of longest wall pairs, per rotation, from which translations are computed."""
MOST = 1000
"""Number of translations evaluated per rotation."""
AGREE_M = 0.15
"""Largest offset of a wall that agrees with a translation."""


@helper
def _turned(tracks: Tracks, seen: Seen) -> tuple[Floats, Floats]:
    """Return the rotation from each track to each wall, and its supporting length; (n, m)."""
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
            if abs(turn[i, j]) < REACH_RAD and abs(moved) < REACH_M:
                weight[i, j] = min(own, size[j])
    return turn, weight


@helper
def _support(turn: Floats, weight: Floats, chosen: float) -> tuple[float, float]:
    """Return the wall length that is parallel after a rotation, and the mean deviation.

    Each observed wall counts once, with the longest track parallel to it.
    """
    total, off_total = 0.0, 0.0
    for j in range(turn.shape[1]):
        best, off_best = 0.0, 0.0
        for i in range(turn.shape[0]):
            if weight[i, j] <= best:
                continue
            off = half_turn(turn[i, j] - chosen)
            near = weight[i, j] * max(1 - (off / ALIKE_RAD) ** 2, 0.0)
            if near > best:
                best, off_best = near, off
        total += best
        off_total += best * off_best
    return total, off_total / max(total, 1e-12)


@helper
def turns(tracks: Tracks, seen: Seen) -> Floats:
    """Return the rotations that make most wall length parallel, best first; (k,).

    Small rotations are preferred.
    """
    turn, weight = _turned(tracks, seen)
    n, m = turn.shape
    every, mean, support = np.empty(n * m), np.empty(n * m), np.zeros(n * m)
    for k in range(n * m):
        i, j = k // m, k % m
        every[k] = turn[i, j]
        if weight[i, j] > 0:
            total, off = _support(turn, weight, every[k])
            mean[k] = every[k] + off
            unusual = half_turn(every[k]) / USUAL_RAD
            support[k] = total * math.exp(-0.5 * unusual**2)
    found, count = np.empty(TURNS), 0
    while count < TURNS:
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
def _lines(tracks: Tracks, seen: Seen, yaw: float) -> Floats:
    """Return the constraints (k, 4) of parallel pairs of walls: normal, distance, size."""
    angle, _, ends, _, _ = tracks
    wall_ends, _, normal, size, _, _ = seen
    n, m = len(angle), len(size)
    weight, lines = np.empty(n * m), np.empty((n * m, 4))
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
            if abs(way) < REACH_M:
                weight[count] = -min(own, size[j])
                lines[count, 0], lines[count, 1], lines[count, 2] = nx, ny, way
                lines[count, 3] = -weight[count]
                count += 1
    return _rows(lines, ordered(weight[:count]), LINES)


@helper
def _rows(of: Floats, which: Ints, most: int) -> Floats:
    """Return the first of the chosen rows (k,)."""
    found = np.empty((min(len(which), most), of.shape[1]))
    for i in range(len(found)):
        for k in range(of.shape[1]):
            found[i, k] = of[which[i], k]
    return found


@helper
def _noted(found: Floats, count: int, x: float, y: float, taken: Bools) -> int:
    """Add a translation if it is in range and new; return the number of translations."""
    if not math.hypot(x, y) < REACH_M or count == len(found):
        return count
    i, j = int((x + REACH_M) / CELL_M), int((y + REACH_M) / CELL_M)
    if taken[i, j]:
        return count
    taken[i, j] = True
    found[count, 0], found[count, 1] = x, y
    return count + 1


@helper
def _corners(tracks: Tracks, seen: Seen, yaw: float, found: Floats, taken: Bools) -> int:
    """Add translations that match two corners for one rotation; return the number."""
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
                if static[j, e]:  # x and y are NaN for a track without that corner
                    count = _noted(found, count, x, y, taken)
    return count


@helper
def _places(tracks: Tracks, seen: Seen, yaw: float) -> Floats:
    """Return the translations (k, 2) implied by corners and crossing walls for one rotation.

    Translations perpendicular to each wall are included. They are sorted by the length of agreeing
    walls.
    """
    cells = np.int64(2 * math.ceil(REACH_M / CELL_M) + 1)
    taken = np.zeros((cells, cells), dtype=np.bool_)
    lines, found = _lines(tracks, seen, yaw), np.empty((MOST, 2))
    across, way, size = lines[:, :2], lines[:, 2], lines[:, 3]
    count = _corners(tracks, seen, yaw, found, taken)
    for p in range(len(way)):
        x, y = way[p] * across[p, 0], way[p] * across[p, 1]
        count = _noted(found, count, x, y, taken)
        for q in range(p):
            det = across[p, 0] * across[q, 1] - across[p, 1] * across[q, 0]
            if abs(det) > CROSSING:
                x = (way[p] * across[q, 1] - way[q] * across[p, 1]) / det
                y = (way[q] * across[p, 0] - way[p] * across[q, 0]) / det
                count = _noted(found, count, x, y, taken)
    against = np.zeros(count)
    for k in range(count):
        for p in range(len(way)):
            off = across[p, 0] * found[k, 0] + across[p, 1] * found[k, 1] - way[p]
            against[k] -= size[p] * max(1 - (off / AGREE_M) ** 2, 0.0)
    return _rows(found, ordered(against), count)


@compiled
def implied(tracks: Tracks, seen: Seen, reach_rad: float) -> Floats:
    """Return the motions (k, 3) implied by walls and corners, at most `EACH` per rotation.

    `reach_rad`: rotations by more are left out.
    """
    motions, count = np.empty((TURNS * EACH, 3)), 0
    for yaw in turns(tracks, seen):
        if abs(yaw) >= reach_rad:
            continue
        ways = _places(tracks, seen, yaw)
        for k in range(min(len(ways), EACH)):
            motions[count, 0] = yaw
            motions[count, 1], motions[count, 2] = ways[k, 0], ways[k, 1]
            count += 1
    return motions[:count]
