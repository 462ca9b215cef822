"""Planes that no scan shows by itself: found in the points on no plane of all scans together.

Each scan of a lidar has one or two rings on a table top that it grazes. In the frame of a refined
submap the rings of many scans make a plane.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.scan import TINY
from relmap.planes3d.adjustment import NORMAL, across
from relmap.planes3d.sights import is_seen_through
from relmap.planes3d.submap import Submap
from relmap.planes3d.surfaces import Surfaces
from relmap.segmentation.space import Patches
from relmap.segmentation.space.growing import grown, joined, planes_of
from relmap.segmentation.space.voxels import ROUNDING, moments_of, principal, uniform_voxels

SIZES, SHIFTS = (0.25, 0.5, 1.0), (0.0, 0.5)
"""Sizes of voxels, by those of the segmenter, and shifts of their grid, by their own size: a voxel
across the edge of a small plane is not flat."""
KNOWN_CELLS, KNOWN_SD, PIECE_SD = 1.5, 3.0, 6.0
"""Points within this many cells of the surface of a plane, and this many standard deviations,
belong to it. Planes with half of their points within the last value are its noise."""
TRIMMED, TRIM_SD = 12, 2.0
"""Number of times that the points of a plane are chosen, and standard deviations within which they
are: other points in its voxels would tilt it."""
WIDE = 0.25
"""Minimum standard deviation of the points of a plane along its width, by the size of voxels."""
BESIDE_CELLS, AROUND = 1.5, 6
"""Points within this many cells of a plane that moved away belong to what moves, while it was seen
and so many scans before and after."""
FEWEST, FEWEST_SCANS = 24, 3
"""Minimum number of points of a plane, and of scans that see it."""
ROUGH, SMOOTH, THIN = 3.0, 1.25, 1e-3
"""The points of a plane have at most this many times the usual noise, of one that too few scans
show at most the second value; noise below the third, a fraction of the range, counts as that
much."""
BINS, FEW = 8, 20
"""Number of ranges at which the usual noise is found, and least number of patches at each."""


def gathered(part: Submap, number: int) -> Submap | None:
    """Add the planes that the points on no plane show together, as observations of their scans.

    `part`: refined, so that its poses are consistent; `number`: of the first new landmark. Returns
    None if there are none.
    """
    rough, enough = roughness(part), part.n_scans >= FEWEST_SCANS
    planes = part.planes(np.flatnonzero(enough & (rough <= ROUGH)))
    # A plane that too few scans show by themselves is gathered, too, and joined afterwards.
    few = part.planes(np.flatnonzero(~enough & (rough <= SMOOTH)))
    if not len(planes):
        return None
    own = [seen.loose for seen in part.seen]
    scan = np.repeat(np.arange(len(own)), [len(each) for each in own])
    points = np.concatenate([x @ R.T + t for x, (R, t) in zip(own, part.poses, strict=True)])
    sigma = max(float(np.median(planes.spread[:, 2])), ROUNDING * planes.reach_m + TINY)
    label = _labels(points, scan, part, (planes, few), sigma)
    count = int(label.max(initial=-1)) + 1
    if not count:
        return None
    label = joined(moments_of(points, label, count), np.full(count, sigma**2))[label]
    return _with_planes(part, points, scan, label, number, sigma)


def _labels(
    points: Floats, scan: Ints, part: Submap, known: tuple[Patches, Patches], sigma: float
) -> Ints:
    """Return the plane (n,) of points (n, 3), -1 for none.

    `scan` (n,): of each; `known`: planes of the submap that enough scans show by themselves, and
    those that too few do; `sigma`, metres: noise of the points across planes.
    """
    (planes, few), label, count = known, np.full(len(points), -1), 0
    of, off = _nearby(points, planes)
    left = np.flatnonzero((off > KNOWN_SD).all(axis=1))
    left = left[~_moves(points[left], scan[left], part)]
    searches: list[tuple[float, Callable[[Floats], list[Ints]]]]
    searches = [(planes.cell_m, partial(_regions_on, few))]
    for size, shift in itertools.product(SIZES, SHIFTS):
        size_m = size * planes.cell_m
        searches.append((size_m, partial(_regions_in, size_m, shift * size_m, sigma)))
    for size_m, regions_of in searches:
        free = points[left]
        for mine in regions_of(free):
            mine = mine[label[left[mine]] < 0]
            if len(mine) < FEWEST:
                continue  # most of it lies beside another one
            rows = left[mine[_on_plane(free[mine])]]
            piece = np.bincount(of[rows][off[rows] < PIECE_SD]).max(initial=0) > len(rows) / 2
            if not piece and _is_plane(points[rows], scan[rows], size_m):
                rows = left[_beside(free, points[rows], size_m)]
                label[rows[label[rows] < 0]], count = count, count + 1
        left = left[label[left] < 0]
    return label


def _moves(points: Floats, scan: Ints, part: Submap) -> Bools:
    """Return which points (n, 3) are near what moves at its time.

    A landmark that few scans show by themselves is not known to move yet: others may have points.
    """
    rows = np.flatnonzero(is_seen_through(part))
    if not len(rows):
        return np.zeros(len(points), dtype=bool)
    (first, last), moving = part.spans, part.planes(rows)
    reach_m = BESIDE_CELLS * moving.cell_m
    near = Surfaces(moving, 2 * reach_m).nearest(points, reach_m, 8)
    of, at = rows[near], scan[:, None]
    during = (at >= first[of] - AROUND) & (at <= last[of] + AROUND)
    return np.asarray((during & (near >= 0)).any(axis=1))


def _nearby(points: Floats, planes: Patches) -> tuple[Ints, Floats]:
    """Return planes near points (n, 8), and the distances from them in standard deviations."""
    reach_m = KNOWN_CELLS * planes.cell_m
    of = Surfaces(planes, 2 * reach_m).nearest(points, reach_m, 8)
    # One column for each plane of a point.
    of = np.sort(np.where(of < 0, len(planes), of), axis=1)
    of[:, 1:][of[:, 1:] == of[:, :-1]] = len(planes)
    noise = planes.spread[:, 2] + ROUNDING * planes.reach_m
    off = np.full(of.shape, np.inf)
    point, column = np.nonzero(of < len(planes))
    plane = of[point, column]
    height = np.einsum("ni,ni->n", planes.normal[plane], points[point]) - planes.offset[plane]
    off[point, column] = np.abs(height) / noise[plane]
    return of, off


def _regions_on(planes: Patches, points: Floats) -> list[Ints]:
    """Return the rows of points (n, 3) at the surface of each of some planes."""
    rows, noise = [], planes.spread[:, 2] + ROUNDING * planes.reach_m
    for k in range(len(planes)):
        off = np.abs(points @ planes.normal[k] - planes.offset[k])
        on = np.flatnonzero(off <= KNOWN_SD * noise[k])
        cells, reach_m = planes.cells[planes.cell_patch == k], KNOWN_CELLS * planes.cell_m
        rows.append(on[cKDTree(cells).query(points[on], distance_upper_bound=reach_m)[0] < np.inf])
    return rows


def _regions_in(size_m: float, shift_m: float, sigma: float, points: Floats) -> list[Ints]:
    """Return the rows of points (n, 3) of each plane that grows in voxels on a shifted grid."""
    if len(points) < FEWEST:
        return []
    voxels = uniform_voxels(points + shift_m, size_m)
    label = grown(voxels, voxels.flat, np.full(len(voxels.centre), sigma))[voxels.of]
    return [np.flatnonzero(label == k) for k in range(int(label.max(initial=-1)) + 1)]


def _on_plane(points: Floats) -> Ints:
    """Return the rows of points (n, 3) on the plane of most of them."""
    rows = np.arange(len(points))
    for _ in range(TRIMMED):
        moments = moments_of(points[rows], np.zeros(len(rows), np.int64), 1)
        plane = planes_of(moments)[0]
        off = np.abs(points @ plane[:3] - plane[3])
        usual = np.median(off) / NORMAL
        before = rows
        rows = np.flatnonzero(off <= TRIM_SD * usual + ROUNDING * np.abs(points).max())
        if np.array_equal(rows, before):
            break
    return rows


def _beside(points: Floats, own: Floats, reach_m: float) -> Ints:
    """Return the rows of points (n, 3) on the plane of some, (k, 3), and near these.

    A region ends before the edge of its plane, where voxels are not flat.
    """
    plane = planes_of(moments_of(own, np.zeros(len(own), np.int64), 1))[0]
    off = np.abs(points @ plane[:3] - plane[3])
    most = KNOWN_SD * np.sqrt(np.mean((own @ plane[:3] - plane[3]) ** 2))
    rows = np.flatnonzero(off <= most + ROUNDING * np.abs(own).max())
    near = cKDTree(own).query(points[rows], distance_upper_bound=reach_m)[0] < np.inf
    return np.asarray(rows[near])


def _is_plane(points: Floats, scan: Ints, size_m: float) -> bool:
    """Return whether points (n, 3) are enough, seen in enough scans, and on no narrow strip."""
    width = np.sqrt(principal(moments_of(points, np.zeros(len(points), np.int64), 1))[1][0, 1])
    enough = len(points) >= FEWEST and len(np.unique(scan)) >= FEWEST_SCANS
    return bool(enough and width > WIDE * size_m)


def _with_planes(
    part: Submap, points: Floats, scan: Ints, label: Ints, number: int, sigma: float
) -> Submap:
    """Return the submap with its points (n, 3) on planes (n,) as observations of their scans."""
    count = int(label.max()) + 1
    _, variance, axes = principal(moments_of(points, label, count))
    sd = np.maximum(np.sqrt(variance[:, 0]), 0.1 * sigma)
    normal = axes[:, 0] * _fronts(part, points, scan, label, axes[:, 0])[:, None]
    mine = np.flatnonzero(label >= 0)
    mine = mine[np.lexsort((label[mine], scan[mine]))]
    pair, of = np.unique(scan[mine] * count + label[mine], return_inverse=True)
    at, plane = np.divmod(pair, count)
    R = np.array([R for R, _ in part.poses])[at]
    own = np.concatenate([seen.loose for seen in part.seen])[mine]
    more = _patches(own, of, np.einsum("pji,pj->pi", R, normal[plane]), sd[plane])
    patches, numbers = [], []
    for k, seen in enumerate(part.seen):
        seen = replace(seen, loose=seen.loose[label[scan == k] < 0])
        rows = slice(*np.searchsorted(at, [k, k + 1]))
        patches.append(
            _with_more(seen, more, rows, slice(*np.searchsorted(scan[mine], [k, k + 1])))
        )
        numbers.append(np.append(part.number[part.match[k]], number + plane[rows]))
    again = Submap()
    again.extend(part.iteration, patches, part.poses, numbers)
    again.take_over(part)
    return again


def _fronts(part: Submap, points: Floats, scan: Ints, label: Ints, normal: Floats) -> Floats:
    """Return 1 or -1 for each normal (m, 3): the side of its plane from which most was seen."""
    ahead = np.array([t for _, t in part.poses])[scan] - points
    mine = label >= 0
    height_m = np.einsum("ni,ni->n", ahead[mine], normal[label[mine]])
    return np.where(np.bincount(label[mine], height_m, len(normal)) < 0, -1.0, 1.0)


def _patches(points: Floats, of: Ints, normal: Floats, sd: Floats) -> Patches:
    """Return patches of points (n, 3), robot frame, with given normals (m, 3) and noise (m,)."""
    number = np.bincount(of)
    centre = moments_of(points, of, len(sd))[:, 1:4] / number[:, None]
    e, f = across(normal)
    off = points - centre[of]
    x, y = (np.einsum("ni,ni->n", off, side[of]) for side in (e, f))
    xx, yy, xy = (np.bincount(of, square) / number for square in (x * x, y * y, x * y))
    angle = np.arctan2(2 * xy, xx - yy)[:, None] / 2
    u = np.cos(angle) * e + np.sin(angle) * f
    mean, apart = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    variance = np.column_stack([mean + apart, np.maximum(mean - apart, 0.0), sd**2])
    weight = number / sd**2
    tilt = weight[:, None] * np.maximum(variance[:, :2] - variance[:, 2:], 0.0)
    axes = np.stack([u, np.cross(normal, u), normal], axis=1)
    cells = centre[of] + x[:, None] * e[of] + y[:, None] * f[of]
    information = np.column_stack([tilt, weight])
    return Patches(centre, axes, information, np.sqrt(variance), number, cells, of, 0.0, 0.0)


def _with_more(seen: Patches, more: Patches, rows: slice, cells: slice) -> Patches:
    """Return the patches of a scan and rows of others, which have these cells."""
    names = ("centre", "axes", "information", "spread", "n_points")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(seen, name), getattr(more, name)[rows]]) for name in names
    }
    patch = len(seen) - rows.start + more.cell_patch[cells]
    return replace(
        seen,
        **columns,
        cells=np.concatenate([seen.cells, more.cells[cells]]),
        cell_patch=np.append(seen.cell_patch, patch),
    )


def is_rough(part: Submap) -> Bools:
    """Return which landmarks (l,) are not planes: rougher than the noise of the sensor."""
    return roughness(part) > ROUGH


def roughness(part: Submap) -> Floats:
    """Return the thickness (l,) of landmarks, relative to the usual noise at their ranges.

    A flight of stairs is grown as a slope where a scan has few points on each tread. Observations
    count by their information: one that shows a plane outweighs many that are thick.
    """
    range_m = np.concatenate([np.linalg.norm(seen.centre, axis=1) for seen in part.seen])
    off_m = np.concatenate([seen.spread[:, 2] for seen in part.seen])
    weight = np.concatenate([seen.information[:, 2] for seen in part.seen])
    landmark = np.concatenate(part.match)
    order = np.argsort(range_m, kind="stable")
    parts = np.array_split(order, min(BINS, len(order) // FEW + 1))
    usual = [(np.median(range_m[rows]), np.median(off_m[rows])) for rows in parts]
    usual_m = np.maximum(np.interp(range_m, *np.array(usual).T), THIN * range_m)
    sums = [np.bincount(landmark, weight * each**2, len(part)) for each in (off_m, usual_m)]
    return np.asarray(np.sqrt(sums[0] / sums[1]))
