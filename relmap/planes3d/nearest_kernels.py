"""Nearest cells of the map, compiled; see `relmap.planes3d.fitting.Surfaces`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Counts, Floats, Ints
from relmap.core.geometry.spatialindex_kernels import bucket_of, cell_at, key_of
from relmap.core.linalg.compiling import compiled, helper
from relmap.planes3d.placing import HOPELESS, JUDGED
from relmap.planes3d.surfaces import SIDE

Grid = tuple[Counts, Counts, Ints, Ints, Floats, float]
"""The first cube of each bucket, the next cube in the bucket of each cube, and its key, see
`relmap.core.geometry.spatialindex_kernels`; the first cell of each cube, and their number; the
cells (c, 3), cube by cube; and the side of the cubes, metres."""


@compiled
def keys_of(points: Floats, side_m: float) -> Ints:
    """Return the key (n,) of the cube of a grid that holds each point (n, 3)."""
    keys = np.empty(len(points), dtype=np.int64)
    for i in range(len(points)):
        x, y = cell_at(points[i, 0], side_m), cell_at(points[i, 1], side_m)
        keys[i] = key_of(x, y, cell_at(points[i, 2], side_m))
    return keys


@helper
def _enter(one: int, away: float, chosen: Ints, square: Floats) -> None:
    """Insert a cell among the nearest ones found, nearest first; the last one drops out."""
    place = len(square) - 1
    while place > 0 and square[place - 1] > away:
        square[place], chosen[place] = square[place - 1], chosen[place - 1]
        place -= 1
    square[place], chosen[place] = away, one


@helper
def _look_in(
    wanted: int, grid: Grid, x: float, y: float, z: float, chosen: Ints, square: Floats
) -> None:
    """Look for the nearest cells in the cube with a key."""
    first, following, key, begin, cells, _ = grid
    cube = first[bucket_of(wanted, len(first))]
    while cube >= 0 and key[cube] != wanted:
        cube = following[cube]
    if cube < 0:
        return
    for one in range(begin[cube], begin[cube + 1]):
        ax, ay, az = cells[one, 0] - x, cells[one, 1] - y, cells[one, 2] - z
        away = ax * ax + ay * ay + az * az
        if away < square[-1]:
            _enter(one, away, chosen, square)


@helper
def _nearest_to(
    grid: Grid, x: float, y: float, z: float, reach_m: float, chosen: Ints, square: Floats
) -> None:
    """Set the cells (k,) nearest to a point, nearest first, and their squared distances."""
    side_m = grid[5]
    for k in range(len(chosen)):
        chosen[k], square[k] = len(grid[4]), reach_m * reach_m
    own = key_of(cell_at(x, side_m), cell_at(y, side_m), cell_at(z, side_m))
    _look_in(own, grid, x, y, z, chosen, square)
    # Then only in cubes that are nearer than what the own one holds.
    r = np.sqrt(square[-1])
    for i in range(cell_at(x - r, side_m), cell_at(x + r, side_m) + 1):
        for j in range(cell_at(y - r, side_m), cell_at(y + r, side_m) + 1):
            for k in range(cell_at(z - r, side_m), cell_at(z + r, side_m) + 1):
                wanted = key_of(i, j, k)
                if wanted != own:
                    _look_in(wanted, grid, x, y, z, chosen, square)


@compiled
def nearest(grid: Grid, points: Floats, reach_m: float, count: int) -> Ints:
    """Return the cells (n, count) nearest to each point (n, 3), nearest first.

    Fewer within reach are filled up with the number of cells.
    """
    found, square = np.empty((len(points), count), dtype=np.int64), np.empty(count)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        _nearest_to(grid, x, y, z, reach_m, found[i], square)
    return found


@compiled
def mark_near(
    grid: Grid,
    plane: Ints,
    R: Floats,
    t: Floats,
    cells: Floats,
    of: Ints,
    reach_m: float,
    near: Bools,
) -> None:
    """Mark which planes of a scan have cells near which planes of the map, in an array (m, k).

    `plane` (c,): plane of each cell of the map. `R` (3, 3), `t` (3,): pose of the scan. `cells`
    (s, 3), `of` (s,): of the scan, and their planes. `reach_m`: largest distance; the four nearest
    cells count.
    """
    x, chosen, square = np.empty(3), np.empty(4, dtype=np.int64), np.empty(4)
    for i in range(len(cells)):
        for a in range(3):
            x[a] = t[a]
            for b in range(3):
                x[a] += R[a, b] * cells[i, b]
        _nearest_to(grid, x[0], x[1], x[2], reach_m, chosen, square)
        for k in chosen:
            if plane[k] >= 0:
                near[of[i], plane[k]] = True


@compiled
def shares(
    grid: Grid,
    facing: Floats,
    R: Floats,
    t: Floats,
    cells: Floats,
    normal: Floats,
    weight: Floats,
    reach_m: float,
) -> Floats:
    """Return the weight (h,) of the cells of a scan that a motion brings near cells of the map.

    `facing` (c, 3): normals of the cells of the map; `R` (h, 3, 3), `t` (h, 3); `cells`, `normal`
    (s, 3), `weight` (s,): of the scan; `reach_m`: largest distance. Motions with less than a
    fraction of the largest weight, or not among the largest ones, are not followed to the end.
    """
    total, best = np.zeros(len(R)), np.zeros(JUDGED)
    x, n = np.empty(3), np.empty(3)
    chosen, square = np.empty(1, dtype=np.int64), np.empty(1)
    for h in range(len(R)):
        rest = weight.sum()
        for i in range(len(cells)):
            for a in range(3):
                x[a], n[a] = t[h, a], 0.0
                for b in range(3):
                    x[a] += R[h, a, b] * cells[i, b]
                    n[a] += R[h, a, b] * normal[i, b]
            _nearest_to(grid, x[0], x[1], x[2], reach_m, chosen, square)
            rest -= weight[i]
            k = chosen[0]
            if k < len(facing):
                cosine = n[0] * facing[k, 0] + n[1] * facing[k, 1] + n[2] * facing[k, 2]
                total[h] += weight[i] if cosine > SIDE else 0.0
            if total[h] + rest < max(HOPELESS * best[0], best[JUDGED - 1]):
                break
        place = JUDGED - 1
        while place > 0 and best[place - 1] < total[h]:
            best[place], place = best[place - 1], place - 1
        best[place] = max(best[place], total[h])
    return total
