"""Where beams hit walls and where they contradict them, compiled; see `plan_evidence`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import unset
from relmap.planes.plan.evidence import BIN_M, LEAST_SINE

Four = tuple[float, float, float, float]


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
