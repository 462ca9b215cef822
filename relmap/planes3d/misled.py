"""Landmarks that may move with the sensor, and steps that what scans see contradicts.

Points may lead away from a step, planes lie beside those of the scan before, or scans see through
planes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.scan import TINY
from relmap.planes3d.certainty import NEARBY
from relmap.planes3d.fitting import SYSTEMATIC
from relmap.planes3d.sights import FEWEST, cells_at, looks
from relmap.planes3d.submap import Submap
from relmap.segmentation.space import Patches

QUICK, AT_REST, WINDOW = 0.95, 0.4, 12
"""A landmark may move with the sensor if no two of as many scans that saw it as the third value are
farther apart than the second fraction of the way that so many steps are if the sensor moves. A step
is then the first value, a quantile of all."""
COMPARED, CLOSER, BETTER = 400, (3.0, 2.0, 1.0), 1.06
"""Number of points of a scan that are compared with those of the scan before; how near to these, in
cells, points are that pull a step, three times; and how many times as many a better step explains.
"""
SHIFTS = np.linspace(-0.09, 0.09, 10)
"""Other steps that are tried: shifts, as fractions of the range."""
AT_LEAST, REMAINS = 8, 0.5
"""Number of looks through large planes, in a step and those around it, that contradict it if there
is one a step, and the largest fraction of them that goes through at another step."""
EDGE = 1.8
"""Half the width of a plane, in standard deviations of its points along it."""
PARALLEL, SLIGHT = np.cos(np.deg2rad(8.0)), 0.04
"""Least cosine of the normals of planes of two scans that may be one surface, and least extent of
both, the standard deviation of the points as a fraction of the range."""
OFF, SAME, ACROSS = (0.0125, 0.1), 0.003, 0.5
"""How far a plane may be beside that of the scan before, and the distance of planes that are one,
unless they are less certain, as fractions of the range; and least cosine of the normal of a plane
and the direction in which it shows a step."""
AGREE, MORE = 2, 1.25
"""Number of planes that lie on those of the scan before at another step, and as many times larger
they are together than those that do at the step of the map."""


def quick_step_m(parts: Iterable[Submap]) -> float:
    """Return how far the sensor moves from scan to scan where it does not rest, metres."""
    steps = [
        np.linalg.norm(np.diff(part.trajectory[:, :3, 3], axis=0), axis=1) / np.diff(part.iteration)
        for part in parts
    ]
    return float(np.quantile(np.concatenate([*steps, [0.0]]), QUICK))


def comes_along(part: Submap, quick_m: float) -> Bools:
    """Return which landmarks (l,) may move with the sensor: it hardly moved while it saw them.

    What moves at its pace makes it seem to rest. Where it does rest, those that it saw before or
    afterwards, too, determine where it is. `quick_m`: see `quick_step_m`.
    """
    T, found = part.trajectory, np.zeros(len(part), dtype=np.bool_)
    # A rotation counts by how far it moves points at the range.
    at = np.column_stack([T[:, :3, 3], part.reach_m * T[:, :3, :3].reshape(-1, 9)])
    rows: list[list[int]] = [[] for _ in range(len(part))]
    for k, match in enumerate(part.match):
        for landmark in np.unique(match).tolist():
            rows[landmark].append(k)
    for landmark, own in enumerate(rows):
        last, seen_at = min(len(own) - 1, WINDOW), at[own]
        for lag in range(1, last + 1):
            way_m = np.linalg.norm(seen_at[lag:] - seen_at[:-lag], axis=1).max()
            if way_m >= AT_REST * quick_m * last:
                break
        else:
            found[landmark] = last > 0
    return found


def is_led_away(part: Submap, k: int, usual: Floats) -> bool:
    """Return whether a step near a usual one explains more points of scan `k` than its own.

    Points on no plane count as well: where planes repeat, as on stairs, they tell steps apart. Only
    steps off by more than a cell are told apart. `usual` (u, 3): steps from the scan before, along
    its axes, metres.
    """
    before, ends = part.seen[k - 1].ends, part.seen[k].ends
    if min(len(before), len(ends)) < FEWEST:
        return False
    (S, s), (R, t) = part.poses[k - 1], part.poses[k]
    ends = ends[np.linspace(0, len(ends) - 1, COMPARED).astype(np.int64)].astype(np.float64)
    cell_m = cells_at(part.seen[k], np.linalg.norm(ends, axis=1))
    way, far_m = S.T @ (t - s), float(cell_m.max())
    usual = usual[np.linalg.norm(usual - way, axis=1) > far_m]
    if not len(usual):
        return False
    tree, points = cKDTree(before), ends @ (S.T @ R).T

    def near(at: Floats, cells: float) -> tuple[Ints, Ints]:
        off_m, nearest = tree.query(points + at, distance_upper_bound=cells * far_m)
        rows = np.flatnonzero(off_m < cells * cell_m)
        return rows, np.asarray(nearest)[rows]

    least = BETTER * len(near(way, 1.0)[0])
    for at in usual:
        for cells in CLOSER:
            rows, nearest = near(at, cells)
            at = (before[nearest] - points[rows]).mean(axis=0) if len(rows) else at
        if np.linalg.norm(at - way) > far_m and len(near(at, 1.0)[0]) > least:
            return True
    return False


def lies_beside(part: Submap, k: int) -> bool:
    """Return whether planes of scan `k` lie beside those of the scan before, all equally far.

    Of two surfaces of a relief, or of a wall that a wrong step doubled, a scan may be placed on the
    one that the scan before did not show. The map agrees with both; the two scans do not.
    """
    reach_m = min(part.seen[k - 1].reach_m, part.seen[k].reach_m)
    plane, normal, off_m, sd_m = _counterparts(part, k, SLIGHT * reach_m)
    size_m, gate_m = _extents(part.seen[k]), np.maximum(2 * sd_m, SAME * reach_m)

    def sizes_at(way_m: float, cosine: Floats) -> Floats:
        rows = (np.abs(cosine) > ACROSS) & (np.abs(off_m - way_m * cosine) < gate_m)
        return size_m[np.unique(plane[rows])]

    least_m, most_m = (share * reach_m for share in OFF)
    beside = (np.abs(off_m) > least_m) & (np.abs(off_m) < most_m) & (sd_m < least_m / 2)
    for row in np.flatnonzero(beside):
        cosine = normal @ normal[row]
        there, here = (sizes_at(way_m, cosine) for way_m in (off_m[row], 0.0))
        if len(there) >= AGREE and there.sum() > MORE * here.sum():
            return True
    return False


def _counterparts(part: Submap, k: int, least_m: float) -> tuple[Ints, Floats, Floats, Floats]:
    """Return planes of scan `k` (c,) that may be planes of the scan before, parallel to them.

    Returns also their normals (c, 3), in the frame of that scan, and how far they are in front of
    its planes, at the centre of the smaller of both: distances (c,) and standard deviations (c,).
    `least_m`: extent of both.
    """
    (S, s), (R, t) = part.poses[k - 1 : k + 1]
    before, seen = part.seen[k - 1 : k + 1]
    own, centre = seen.axes @ (S.T @ R).T, (seen.centre @ R.T + t - s) @ S
    size_m, other_m = _extents(seen), _extents(before)
    a, b = np.nonzero(own[:, 2] @ before.normal.T > PARALLEL)
    rows = np.minimum(size_m[a], other_m[b]) > least_m
    a, b = a[rows], b[rows]
    smaller = size_m[a] <= other_m[b]
    axes = np.where(smaller[:, None, None], before.axes[b], own[a])
    spread = np.where(smaller[:, None], before.spread[b], seen.spread[a])
    off = np.einsum("cij,cj->ci", axes, centre[a] - before.centre[b])
    along = np.abs(off[:, :2]) / np.maximum(spread[:, :2], TINY)
    noise = np.column_stack([seen.spread[a, 2], before.spread[b, 2], spread[:, 2:] * along])
    sd_m = SYSTEMATIC * np.linalg.norm(noise, axis=1)
    on = (along < EDGE).all(axis=1)
    return a[on], own[a[on], 2], off[on, 2], sd_m[on]


def _extents(seen: Patches) -> Floats:
    """Return the standard deviation (m,) of the points of planes along them, metres."""
    return np.asarray(np.sqrt(seen.spread[:, :2].prod(axis=1)))


def seen_through_steps(part: Submap, large: Bools, rows: Ints, along: Floats) -> Ints:
    """Return those of some steps (r,) at which scans see through large planes, and need not.

    Two companions with flat backs, ahead of the sensor at its pace, make it seem to stand still.
    Then walls seem to move, and a scan sees through their ends of the scan before; at another step
    along the direction in doubt it does not. Looks in the steps around count as well.

    `large` (l,): which landmarks do not move; `along` (r, 3): directions, axes of the later scan.
    """
    R = np.array([part.poses[k + 1][0] for k in rows]).reshape(-1, 3, 3)
    along = np.einsum("nij,nj->ni", R, along)
    both = {*rows, *(rows + 1)}
    points = {k: _points_on(part.seen[k], large[part.match[k]]) for k in both}
    # All rays count, also those that are not new.
    anew = [replace(x, is_new=np.ones(len(x.ends), dtype=np.bool_)) for x in part.seen]

    def through(k: int, shift: Floats) -> int:
        (S, s), (R, t), reach_m = *part.poses[k : k + 2], part.seen[k].reach_m
        turn, way = S.T @ R, S.T @ (t + shift * reach_m - s)
        looking = (k + 1, k, (turn, way)), (k, k + 1, (turn.T, -turn.T @ way))
        return sum(len(looks(anew[a], pose, *points[b])[1]) for a, b, pose in looking)

    near = np.abs(np.subtract.outer(rows, rows)) <= NEARBY
    now = near @ np.array([through(k, np.zeros(3)) for k in rows.tolist()], dtype=np.int64)
    much = now >= np.maximum(AT_LEAST, near.sum(axis=1))
    if not much.any():
        return rows[:0]
    shifts = along[:, None] * SHIFTS[:, None]
    there = np.array([[through(k, x) for x in at] for k, at in zip(rows, shifts, strict=True)])
    alike = along @ along.T >= 0
    least = ((near & alike) @ there + (near & ~alike) @ there[:, ::-1]).min(axis=1)
    return np.asarray(rows[much & (least <= REMAINS * now)])


def _points_on(seen: Patches, chosen: Bools) -> tuple[Floats, Floats]:
    """Return the ends of rays (e, 3) on chosen planes of a scan, and the normals of these."""
    axes, spread = seen.axes[chosen], seen.spread[chosen]
    ends = seen.ends.astype(np.float64)
    off = np.abs(np.einsum("mij,emj->emi", axes, ends[:, None] - seen.centre[chosen]))
    ray, plane = np.nonzero((off < np.maximum(spread * [EDGE, EDGE, 3.0], 1e-6)).all(axis=2))
    return ends[ray], axes[plane, 2]
