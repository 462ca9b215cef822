"""Where beams hit walls or contradict them, and which walls lie on larger ones, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import unset
from relmap.planes.plan.evidence import BIN_M, LEAST_SINE
from relmap.planes.plan.regrouping import GAP_M, TURN
from relmap.planes.walls.joining import OVERLAP

Four = tuple[float, float, float, float]
Lines = tuple[Floats, Floats, Floats, Floats, Bools]


@helper
def _vote(line: Four, beam: Four, near_m: float, before_m: float) -> tuple[int, float, float]:
    """Return the evidence of a beam for a line: 1 for, -1 against, 0 none; place, and distance.

    `line` is a point and the normal, `beam` the origin and the vector to its end; places along the
    line increase from right to left as seen from its front.
    """
    x, y, nx, ny = line
    fx, fy, dx, dy = beam[0] - x, beam[1] - y, beam[2], beam[3]
    before = nx * fx + ny * fy
    after = before + nx * dx + ny * dy
    place, off = ny * (fx + dx) - nx * (fy + dy), abs(after)
    if off <= near_m:
        return (1 if before > 0 else 0), place, off
    if before * after >= 0:
        return (-1 if 0 < after <= before_m else 0), place, off
    if abs(before - after) < LEAST_SINE * np.hypot(dx, dy):
        return 0, place, off
    crossed = before / (before - after)
    return -1, ny * (fx + crossed * dx) - nx * (fy + crossed * dy), off


@helper
def _cells(beam: Four, corner: Floats, shape: Ints, cell_m: float) -> Ints:
    """Return the cells of a grid along a beam, at steps of a cell's size."""
    x, y, dx, dy = beam
    steps, low, high = int(np.hypot(dx, dy) / cell_m) + 1, 0.0, 1.0  # the part over the grid
    for k in range(2):
        if beam[k + 2] != 0:
            begin = (corner[k] - beam[k]) / beam[k + 2]
            end = begin + shape[k] * cell_m / beam[k + 2]
            low, high = max(low, min(begin, end)), min(high, max(begin, end))
    if not low <= high:
        return np.empty(0, dtype=np.int64)
    first, last = max(int(low * steps) - 1, 0), min(int(high * steps) + 2, steps)
    cells, n = np.empty(last - first + 1, dtype=np.int64), 0
    for s in range(first, last + 1):
        i = int(np.floor((x + s / steps * dx - corner[0]) / cell_m))
        j = int(np.floor((y + s / steps * dy - corner[1]) / cell_m))
        if 0 <= i < shape[0] and 0 <= j < shape[1]:
            cells[n] = i * shape[1] + j
            n += 1
    return cells[:n]


@compiled
def beams_on_walls(
    beams: tuple[Floats, Floats],
    lines: tuple[Floats, Floats, Floats, Ints],
    grid: tuple[Floats, Ints, Ints, Ints, float],
    near_m: float,
    before_m: float,
) -> tuple[Ints, Ints, Floats]:
    """Return how many beams end on each bin (b,) of the walls, and how many contradict it.

    Contradicting beams pass through or end shortly before. Also returns the distance of the end of
    each beam (n,) from the nearest wall, across it; infinity if none is near.

    `beams`: origin and end (n, 2); `lines`: of each wall a point and the normal (w, 2), its start
    (w,) and its first bin (w + 1,); `grid`: its corner (2,), cells along x and y (2,), where the
    walls of each cell begin (c + 1,), the walls, and the size of a cell; `near_m`, `before_m`:
    largest distance of the end of a beam that hits a wall, and distance in front of the wall that
    counts against it.
    """
    (origin, end), (base, normal, low, first) = beams, lines
    corner, shape, starts, members, cell_m = grid
    hits, against = np.zeros(first[-1], dtype=np.int64), np.zeros(first[-1], dtype=np.int64)
    off, last = np.empty(len(end)), unset(len(base))
    for r in range(len(end)):
        off[r] = np.inf
        x, y = origin[r, 0], origin[r, 1]
        beam = x, y, end[r, 0] - x, end[r, 1] - y
        for cell in _cells(beam, corner, shape, cell_m):
            for w in members[starts[cell] : starts[cell + 1]]:
                if last[w] == r:
                    continue
                last[w] = r
                line = base[w, 0], base[w, 1], normal[w, 0], normal[w, 1]
                vote, place, far = _vote(line, beam, near_m, before_m)
                high = low[w] + BIN_M * (first[w + 1] - first[w])
                if vote == 0 or not low[w] <= place < high:
                    continue
                k = min(first[w] + int((place - low[w]) / BIN_M), first[w + 1] - 1)  # rounded
                if vote > 0:
                    hits[k] += 1
                else:
                    against[k] += 1
                off[r] = min(off[r], far)
    return hits, against, off


@helper
def _ends_from(lines: Lines, s: int, k: int) -> tuple[float, float, float]:
    """Return the distances of the ends of wall k from the line of wall s, and along it."""
    middle, normal, along, reach, _ = lines
    x, y = middle[k, 0] - middle[s, 0], middle[k, 1] - middle[s, 1]
    off, places = 0.0, (0.0, 0.0)
    for e in range(2):
        fx, fy = x + reach[k, e] * along[k, 0], y + reach[k, e] * along[k, 1]
        off = max(off, abs(fx * normal[s, 0] + fy * normal[s, 1]))
        places = places[1], fx * along[s, 0] + fy * along[s, 1]
    return off, places[0], places[1]


@compiled
def gathered(
    lines: Lines,
    together: tuple[NDArray[np.int32], NDArray[np.int32]],
    order: Ints,
    across_m: float,
) -> Ints:
    """Return the wall that each (n,) is part of: itself, or the nearest of the earlier ones.

    A wall that absorbs another is extended: `reach` is updated in place.

    `lines`: middle, normal and along (n, 2), reach (n, 2), and which ends are corners (n, 2).
    `together`: for each wall those seen in one scan with it: begin (n + 1,), and walls. `order`:
    the walls (n,), the largest first. `across_m`: largest distance of both ends across, twice as
    large for two walls that overlap and were never seen in one scan.
    """
    (_, normal, _, reach, has_corner), (begin, beside) = lines, together
    n = len(order)
    part, stands, met = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64), unset(n)
    standing = 0
    for k in order:
        for at in range(begin[k], begin[k + 1]):
            met[beside[at]] = k
        size, best, wall, low, high = reach[k, 1] - reach[k, 0], np.inf, k, 0.0, 0.0
        for s in stands[:standing]:
            if normal[s, 0] * normal[k, 0] + normal[s, 1] * normal[k, 1] <= TURN:
                continue
            off, right, left = _ends_from(lines, s, k)
            if off > 2 * across_m or off >= best:
                continue
            inside = min(left, reach[s, 1]) - max(right, reach[s, 0])
            right_m = -GAP_M if has_corner[k, 0] or has_corner[s, 1] else GAP_M
            left_m = -GAP_M if has_corner[k, 1] or has_corner[s, 0] else GAP_M
            fits = off <= across_m
            fits &= right - reach[s, 1] <= right_m and reach[s, 0] - left <= left_m
            if fits or (met[s] != k and inside > OVERLAP * size):
                best, wall, low, high = off, s, right, left
        part[k] = wall
        if wall == k:
            stands[standing] = k
            standing += 1
        else:
            reach[wall, 0], reach[wall, 1] = min(reach[wall, 0], low), max(reach[wall, 1], high)
    return part
