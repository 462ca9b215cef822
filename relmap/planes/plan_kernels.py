"""Where beams end on walls and where they go through them, compiled; see `plan_evidence`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@compiled
def beams_on_walls(
    beams: tuple[Array, Array],
    lines: tuple[Array, Array, Array, Array],
    bins: tuple[Index, float],
    grid: tuple[Array, float, Index, Index, Index],
    limits: tuple[float, float, float],
) -> tuple[Index, Index, Array]:
    """Return how many beams end on each bin (b,) of the walls, and how many where none is.

    They go through it, or end a little before.  And how far each beam (n,) ends from the nearest
    wall, across it; infinity where none is near.

    Parameters
    ----------
    beams : origin and end (n, 2)
    lines : of each wall a point and the normal (w, 2), and from where to where it goes (w,)
    bins : first bin of each wall (w + 1,), and their size in metres
    grid : its corner (2,), size of a cell, cells along x and y (2,), where the walls of each cell
        begin (c + 1,), and the walls
    limits : how far from a wall a beam that ends on it may end, how far before it one ends that
        ends a little before, and the least sine of the angle between a beam and a wall
    """
    origin, end = beams
    base, normal, low, high = lines
    first, bin_m = bins
    corner, cell_m, shape, starts, members = grid
    near_m, before_m, least_sine = limits
    hits, against = np.zeros(first[-1], np.int64), np.zeros(first[-1], np.int64)
    off, last = np.full(len(end), np.inf), np.full(len(base), -1)
    for r in range(len(end)):
        dx, dy = end[r, 0] - origin[r, 0], end[r, 1] - origin[r, 1]
        length = np.hypot(dx, dy)
        steps = int(length / cell_m) + 1
        for s in range(steps + 1):
            x = int((origin[r, 0] + s / steps * dx - corner[0]) / cell_m)
            y = int((origin[r, 1] + s / steps * dy - corner[1]) / cell_m)
            if x < 0 or y < 0 or x >= shape[0] or y >= shape[1]:
                continue
            cell = x * shape[1] + y
            for m in range(starts[cell], starts[cell + 1]):
                w = members[m]
                if last[w] == r:
                    continue
                last[w] = r
                nx, ny = normal[w]
                fx, fy = origin[r, 0] - base[w, 0], origin[r, 1] - base[w, 1]
                before = nx * fx + ny * fy
                after = before + nx * dx + ny * dy
                # Along a wall is from right to left as seen from its front.
                place = ny * (fx + dx) - nx * (fy + dy)
                if before > 0 and low[w] <= place < high[w]:
                    k = first[w] + int((place - low[w]) / bin_m)
                    off[r] = min(off[r], abs(after))
                    if abs(after) <= near_m:
                        hits[k] += 1
                    elif 0 < after <= before_m:
                        against[k] += 1
                if before * after >= 0 or abs(after) <= near_m:
                    continue
                if abs(before - after) < least_sine * length:
                    continue
                place = ny * fx - nx * fy + (ny * dx - nx * dy) * before / (before - after)
                if low[w] <= place < high[w]:
                    against[first[w] + int((place - low[w]) / bin_m)] += 1
    return hits, against, off
