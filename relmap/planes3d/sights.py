"""How often scans saw a plane where it is, and how often they saw through it: what moved away.

Also where surfaces end: points just beyond them that a scan saw through.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.planes3d.doubting import sight_of
from relmap.planes3d.submap import Pose, Submap
from relmap.planes3d.surfaces import some_cells
from relmap.segmentation.space import Patches
from relmap.segmentation.space.voxels import NEAR, cells_of

AROUND = 4
"""Number of the rays of a scan next to each cell that is looked for: a scan sees through a cell if
all of these end beyond it, the nearest behind it."""
FACING = 0.3
"""Minimum cosine at which a surface is seen."""
BESIDE, FURTHER = 1.0, 2.5
"""Largest distance, in cells at the range, of the nearest ray from a cell, and by how much the
others may be further away."""
BEYOND, EVERY = 2.0, 4
"""Distance of the points beyond a surface from its cells, in cells; one of so many cells is tried
in a scan, others in the next ones."""


def with_rim(seen: Patches, iteration: int) -> Patches:
    """Return the planes of a scan, robot frame, with their rim; see `Patches`."""
    cells, of = (each[iteration % EVERY :: EVERY] for each in (seen.cells, seen.cell_patch))
    u, v = seen.axes[of, 0], seen.axes[of, 1]
    way = np.stack([u, -u, v, -v], axis=1)
    beyond = (cells[:, None] + BEYOND * seen.cell_m * way).reshape(-1, 3)
    tried = replace(seen, cells=beyond, cell_patch=np.repeat(of, 4))
    through = sight_of(np.eye(3), np.zeros(3), seen, tried).through
    return replace(seen, rim=beyond[through], rim_patch=tried.cell_patch[through])


def with_ends(seen: Patches) -> Patches:
    """Return the planes of a scan with the places where its rays ended; see `Patches`."""
    keys, of = cells_of(seen.loose, np.linalg.norm(seen.loose, axis=1), seen.cell_m, seen.reach_m)
    first = np.empty(len(keys), dtype=np.int64)
    first[of[::-1]] = np.arange(len(of))[::-1]
    ends = np.concatenate([seen.cells, seen.loose[first]])
    return replace(seen, ends=ends[ends.any(axis=1)].astype(np.float32))


def sights_of(part: Submap) -> dict[int, Ints]:
    """Return for the numbers of landmarks how often scans saw a cell where it is, or through it."""
    planes, count = part.planes(np.arange(len(part))), len(part)
    rows = some_cells(planes)
    cells, of = planes.cells[rows], planes.cell_patch[rows]
    counts = np.zeros((count, 2), dtype=np.int64)
    for seen, pose in zip(part.seen, part.poses, strict=True):
        there, through = _looks(seen, pose, cells, planes.normal[of])
        counts[:, 0] += np.bincount(of[there], minlength=count)
        counts[:, 1] += np.bincount(of[through], minlength=count)
    return {int(part.number[k]): counts[k] for k in np.flatnonzero(counts.any(axis=1))}


def _looks(seen: Patches, pose: Pose, cells: Floats, normal: Floats) -> tuple[Ints, Ints]:
    """Return the rows of cells (c, 3), submap frame, where a scan sees a surface, or through it.

    `normal` (c, 3): of their planes.
    """
    R, t = pose
    ends = seen.ends.astype(np.float64)
    range_m = np.linalg.norm(ends, axis=1)
    at, far_m = (cells - t) @ R, range_m.max(initial=0.0)
    away, front = np.linalg.norm(at, axis=1), normal @ R
    height_m = np.einsum("ci,ci->c", at, front)
    facing = np.abs(height_m) > FACING * away
    rows = np.flatnonzero(facing & (away < far_m))
    if not len(rows):
        return rows, rows
    off, ray = cKDTree(ends / range_m[:, None]).query(at[rows] / away[rows, None], k=AROUND)
    range_m, away = np.append(range_m, far_m)[ray], away[rows, None]
    near = off < BESIDE * _cell_m(seen, range_m) / range_m * [1.0, *[FURTHER] * (AROUND - 1)]
    beyond_m, cell_m = range_m - away, _cell_m(seen, away)
    there = (near & (np.abs(beyond_m) < cell_m)).any(axis=1)
    # A ray beside the cell may graze the same surface farther away: one through it ends behind it.
    end = np.append(ends, [[0.0] * 3], axis=0)[ray][:, 0]
    behind_m = np.einsum("ci,ci->c", end, front[rows]) - height_m[rows]
    behind = behind_m * np.sign(height_m[rows]) > FACING * cell_m[:, 0]
    through = (~near | (beyond_m > cell_m)).all(axis=1) & behind
    return rows[near[:, 0] & there], rows[near[:, 0] & through]


def _cell_m(seen: Patches, range_m: Floats) -> Floats:
    """Return the size of the cells of a scan at some ranges."""
    return seen.cell_m * np.sqrt(np.maximum(range_m / seen.reach_m, NEAR))
