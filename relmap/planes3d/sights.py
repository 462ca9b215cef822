"""What scans see of a map: where its surfaces are, and where they saw through them.

That shows what moved away, where surfaces end, and placements that fit and are wrong all the same:
seen through, or too far for the time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints, evenly
from relmap.planes3d.placing import LEAP, Placed, apart, moved_m
from relmap.planes3d.submap import Pose, Submap
from relmap.planes3d.surfaces import LOOKED_AT, some_cells
from relmap.segmentation.space import Patches
from relmap.segmentation.space.voxels import NEAR, cells_of

FEWEST = 40
"""Number of looks at the cells of the map, below which more are assumed."""
OFTEN, MANY, BRIEF = 0.2, 3, 6
"""A plane is dynamic if more than this fraction of the looks at its cells, and this number of them,
go through: of a box that moves along one of its faces, a scan sees this plane somewhere else. If no
more scans than the third value saw the plane, half of this fraction of twice as many is enough."""
FACING, EDGE_ON = 0.3, 0.03
"""Minimum cosine at which a surface is looked for, and mean cosine of a landmark below which it is
not a surface: points between an edge and what is behind it, while the sensor hardly moves, lie in
planes through the sensor."""
THROUGH = 0.1
"""Largest fraction of its looks at the map in which a scan may see through, or submaps near in time
at each other: things move."""
FASTER = 2.0
"""A leap, or the step between submaps that are tied, is at most as many times the fastest step."""
SEVERAL = 6
"""Minimum number of scans of a submap that show how fast the sensor moves."""
LEAST_SHARED, MANY_SHARED = 5, 12
"""Minimum number of shared planes of two submaps, and of a scan that jumps and the map: three at
right angles match any others. The second value holds for submaps if a jump is implied, as between
the equal bays of a hall."""
JUMP, FAR, TURN_RAD = 3.0, 0.2, np.deg2rad(45.0)
"""A jump is a translation of at least this many times the longest one of the submaps and this
fraction of the range, or a rotation of more than this angle and `FASTER` times the largest one."""
SOON, SIDES, PLANES, SURFACES = 2, 6, 0.7, 0.8
"""Submaps more scans apart than the first value are tied only if they share more planes than a box
has sides, as rooms look much the same after half a turn, and if one shows at least this fraction of
the planes or of the surfaces of the other: halls look much the same from both ends."""
CONTRADICTED = 0.02
"""Nor if more than this fraction of the looks at the surfaces of the other go through: corridors
look alike, and have their corners elsewhere."""
AROUND = 4
"""Number of the rays of a scan next to each cell that is looked for: a scan sees through a cell if
all of these end beyond it, the nearest behind it."""
NEXT, FURTHER = 1.0, 2.5
"""Largest distance, in cells at the range, of the nearest ray from a cell, and by how much the
others may be further away."""
BEYOND, EVERY = 2.0, 4
"""Distance of the points beyond a surface from its cells, in cells; one of so many cells is tried
in a scan, others in the next ones."""


def is_doubtful(placed: Placed, seen: Patches, planes: Patches, part: Submap, gap: int) -> bool:
    """Return whether a scan, `gap` scans after the last one of a submap, cannot be there.

    `seen`, `planes`: planes of the scan, robot frame, and of the map, map frame.
    """
    way_m = moved_m(part.poses[-1], placed.pose, seen.reach_m)
    if len(part.poses) >= SEVERAL:
        if way_m > LEAP * seen.reach_m and way_m > FASTER * gap * fastest_m(part):
            return True
        few = placed.n_planes < LEAST_SHARED
        if few and _jumps(part.poses[-1], placed.pose, gap, seen.reach_m, part):
            return True
    return seen_through(placed.pose, seen, planes) > THROUGH


def is_tied_doubtfully(placed: Placed, part: Submap, other: Submap) -> bool:
    """Return whether a submap, placed in another, is not there for certain."""
    if placed.free is not None or placed.n_planes < LEAST_SHARED:
        return True
    gaps = np.abs(np.subtract.outer(part.iteration, other.iteration))
    k, m = np.unravel_index(gaps.argmin(), gaps.shape)
    R, t = part.poses[k]
    there = placed.R @ R, placed.R @ t + placed.t
    way_m = moved_m(other.poses[m], there, part.seen[k].reach_m)
    gap = int(gaps[k, m])
    if way_m > FASTER * gap * max(fastest_m(part), fastest_m(other)):
        return True
    jumps = _jumps(other.poses[m], there, gap, part.seen[k].reach_m, part, other)
    if jumps and placed.n_planes < MANY_SHARED:
        return True
    through = contradicted(part, other, placed.pose)
    if gap <= SOON:
        return through > THROUGH
    few = placed.share < SURFACES and placed.n_planes < PLANES * len(part)
    return few or placed.n_planes <= SIDES or through > CONTRADICTED


def fastest_m(part: Submap) -> float:
    """Return the longest step of a submap from scan to scan; infinite if it has none."""
    lengths = (moved_m(a, b, seen.reach_m) / gap for a, b, seen, gap in _steps(part))
    return max(lengths, default=np.inf)


def _steps(part: Submap) -> Iterator[tuple[Pose, Pose, Patches, int]]:
    """Return the two poses of each step, the second scan, and the scans between."""
    poses, seen, number = part.poses, part.seen, part.iteration
    return zip(poses, poses[1:], seen[1:], np.diff(number), strict=False)


def _jumps(last: Pose, pose: Pose, gap: int, reach_m: float, *parts: Submap) -> bool:
    """Return whether a step over `gap` scans is much longer than those of some submaps."""
    turn, way_m = apart(*last, *pose)
    if turn <= TURN_RAD and way_m <= FAR * reach_m:
        return False
    steps = [np.divide(apart(*a, *b), n) for part in parts for a, b, _, n in _steps(part)]
    if not steps:
        return False
    turns, ways_m = gap * np.max(steps, axis=0)
    return bool(turn > max(FASTER * turns, TURN_RAD) or way_m > max(JUMP * ways_m, FAR * reach_m))


def seen_through(pose: Pose, seen: Patches, planes: Patches) -> float:
    """Return the fraction of the looks of a scan at the surfaces of a map that go through.

    `pose`, R (3, 3) and t (3,): of the scan; `seen`, `planes`: of the scan, robot frame, and of the
    map, map frame.
    """
    there, through = looks(seen, pose, planes.cells, planes.normal[planes.cell_patch])
    return len(through) / max(len(there) + len(through), FEWEST)


def with_rim(seen: Patches, iteration: int) -> Patches:
    """Return the planes of a scan with ends, robot frame, with their rim; see `Patches`."""
    tried = slice(iteration % EVERY, None, EVERY)
    cells, of = seen.cells[tried], seen.cell_patch[tried]
    u, v = seen.axes[of, 0], seen.axes[of, 1]
    way = np.stack([u, -u, v, -v], axis=1)
    beyond = (cells[:, None] + BEYOND * seen.cell_m * way).reshape(-1, 3)
    patch, still = np.repeat(of, 4), (np.eye(3), np.zeros(3))
    _, through = looks(seen, still, beyond, seen.normal[patch])
    return replace(seen, rim=beyond[through], rim_patch=patch[through])


def with_ends(seen: Patches) -> Patches:
    """Return the planes of a scan with the places where its rays ended; see `Patches`."""
    keys, of = cells_of(seen.loose, np.linalg.norm(seen.loose, axis=1), seen.cell_m, seen.reach_m)
    first = np.empty(len(keys), dtype=np.int64)
    first[of[::-1]] = np.arange(len(of))[::-1]
    ends = np.concatenate([seen.cells, seen.loose[first]])
    ends = ends[ends.any(axis=1)].astype(np.float32)
    return replace(seen, ends=ends, is_new=np.ones(len(ends), dtype=np.bool_))


def sights_of(part: Submap) -> dict[int, Ints]:
    """Return for the numbers of landmarks how often scans saw a cell where it is, or through it."""
    planes, count = part.planes(np.arange(len(part))), len(part)
    rows = some_cells(planes)
    cells, of = planes.cells[rows], planes.cell_patch[rows]
    counts = np.zeros((count, 2), dtype=np.int64)
    for seen, pose in zip(part.seen, part.poses, strict=True):
        there, through = looks(seen, pose, cells, planes.normal[of])
        counts[:, 0] += np.bincount(of[there], minlength=count)
        counts[:, 1] += np.bincount(of[through], minlength=count)
    return {int(part.number[k]): counts[k] for k in np.flatnonzero(counts.any(axis=1))}


def is_dynamic(part: Submap) -> Bools:
    """Return which landmarks (l,) are not there all the time: scans saw through them."""
    few = (part.n_scans <= BRIEF) & is_seen_through(part, 2)
    return np.asarray(few | is_seen_through(part))


def is_seen_through(part: Submap, fewer: int = 1) -> Bools:
    """Return through which landmarks (l,) scans saw often; see `OFTEN`.

    `fewer`: a smaller fraction is enough, of as many times more looks.
    """
    none = np.zeros(2, dtype=np.int64)
    sights = [part.sights.get(number, none) for number in part.number.tolist()]
    there, through = np.reshape(sights, (-1, 2)).T
    many = through > fewer * MANY
    return np.asarray(many & (fewer * through > OFTEN * (there + through)))


def is_edge_on(part: Submap) -> Bools:
    """Return which landmarks (l,) lie in planes through the sensor, of which it sees no surface."""
    landmark = np.concatenate(part.match)
    centre = np.concatenate([seen.centre for seen in part.seen])
    height_m = np.einsum("mi,mi->m", np.concatenate([seen.normal for seen in part.seen]), centre)
    cosine = np.abs(height_m) / np.linalg.norm(centre, axis=1)
    count = np.bincount(landmark, minlength=len(part))
    return np.asarray(np.bincount(landmark, cosine, len(part)) < EDGE_ON * count)


def contradicted(part: Submap, other: Submap, pose: Pose) -> float:
    """Return the fraction of looks of two submaps at the surfaces of the other that go through.

    `pose`, R (3, 3) and t (3,): of the frame of the first one in that of the other. Surfaces count
    by their area, as what moved between two visits is small.
    """
    back, total = (pose[0].T, -pose[0].T @ pose[1]), np.zeros(2)
    for scans, there, (R, t) in ((part, other, pose), (other, part, back)):
        planes = there.planes(np.arange(len(there)))
        rows = evenly(len(planes.cells), LOOKED_AT * len(planes))
        cells, normal = planes.cells[rows], planes.normal[planes.cell_patch[rows]]
        for seen, (S, s) in zip(scans.seen, scans.poses, strict=True):
            total += [len(each) for each in looks(seen, (R @ S, R @ s + t), cells, normal)]
    return float(total[1] / max(total.sum(), 1.0))


def looks(seen: Patches, pose: Pose, cells: Floats, normal: Floats) -> tuple[Ints, Ints]:
    """Return the rows of cells (c, 3), submap frame, where a scan sees a surface, or through it.

    Only looks along new rays count. `normal` (c, 3): of their planes.
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
    is_new = np.append(seen.is_new, False)[np.asarray(ray)[:, 0]]
    range_m, away = np.append(range_m, far_m)[ray], away[rows, None]
    near = off < NEXT * cells_at(seen, range_m) / range_m * [1.0, *[FURTHER] * (AROUND - 1)]
    beyond_m, cell_m = range_m - away, cells_at(seen, away)
    there = (near & (np.abs(beyond_m) < cell_m)).any(axis=1)
    # A ray beside the cell may graze the same surface farther away: one through it ends behind it.
    end = np.append(ends, [[0.0] * 3], axis=0)[ray][:, 0]
    behind_m = np.einsum("ci,ci->c", end, front[rows]) - height_m[rows]
    behind = behind_m * np.sign(height_m[rows]) > FACING * cell_m[:, 0]
    through = (~near | (beyond_m > cell_m)).all(axis=1) & behind
    looks = near[:, 0] & is_new
    return rows[looks & there], rows[looks & through]


def cells_at(seen: Patches, range_m: Floats) -> Floats:
    """Return the size of the cells of a scan at some ranges."""
    return seen.cell_m * np.sqrt(np.maximum(range_m / seen.reach_m, NEAR))
