"""Planes that no scan shows by itself: found in the points on no plane of all scans together.

Each scan of a lidar has one or two rings on a table top that it grazes. In the frame of a refined
submap the rings of many scans make a plane.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.scan import TINY
from relmap.planes3d.adjustment import NORMAL, across
from relmap.planes3d.submap import Submap
from relmap.planes3d.surfaces import Surfaces
from relmap.segmentation.space import Patches
from relmap.segmentation.space.growing import grown, planes_of
from relmap.segmentation.space.voxels import ROUNDING, moments_of, principal, uniform_voxels

SIZES = (0.5, 1.0)
"""Sizes of voxels, by those of the segmenter."""
KNOWN_CELLS, KNOWN_SD, PIECE_SD = 1.5, 3.0, 6.0
"""Points within this many cells of the surface of a plane, and this many standard deviations,
belong to it. Planes with half of their points within the last value are its noise."""
TRIMMED, TRIM_SD = 12, 2.0
"""Number of times that the points of a plane are chosen, and standard deviations within which they
are: other points in its voxels would tilt it."""
WIDE = 0.25
"""Minimum standard deviation of the points of a plane along its width, by the size of voxels."""
BESIDE_CELLS = 3.0
"""Points within this many cells of a plane that moved away belong to what moves."""
FEWEST, FEWEST_SCANS = 24, 3
"""Minimum number of points of a plane, and of scans that see it."""


def gathered(part: Submap, number: int) -> Submap | None:
    """Add the planes that the points on no plane show together, as observations of their scans.

    `part`: refined, so that its poses are consistent; `number`: of the first new landmark. Returns
    None if there are none.
    """
    sights = np.bincount(np.concatenate([np.unique(match) for match in part.match]))
    # A plane that only one scan shows by itself is gathered, too, and joined afterwards.
    planes = part.planes(np.flatnonzero(sights > 1))
    if not len(planes):
        return None
    own = [part.seen[k].loose for k in range(len(part.poses))]
    scan = np.repeat(np.arange(len(own)), [len(each) for each in own])
    points = np.concatenate([x @ R.T + t for x, (R, t) in zip(own, part.poses, strict=True)])
    label, count = np.full(len(points), -1), 0
    of, off = _nearby(points, planes)
    left = np.flatnonzero((off > KNOWN_SD).all(axis=1) & ~_moves(points, part))
    sigma = max(float(np.median(planes.spread[:, 2])), ROUNDING * planes.reach_m + TINY)
    for size in SIZES:
        size_m = size * planes.cell_m
        for mine in _regions_in(points[left], size_m, sigma):
            rows = left[mine[_on_plane(points[left[mine]])]]
            piece = np.bincount(of[rows][off[rows] < PIECE_SD]).max(initial=0) > len(rows) / 2
            if not piece and _is_plane(points[rows], scan[rows], size_m):
                label[rows], count = count, count + 1
        left = left[label[left] < 0]
    return _with_planes(part, points, scan, label, number, sigma) if count else None


def _moves(points: Floats, part: Submap) -> Bools:
    """Return which points (n, 3) are near a dynamic landmark: they are of the thing that moves."""
    moving = part.planes(np.flatnonzero(part.is_dynamic))
    if not len(moving):
        return np.zeros(len(points), dtype=bool)
    return Surfaces(moving).near(points, BESIDE_CELLS * moving.cell_m) >= 0


def _nearby(points: Floats, planes: Patches) -> tuple[Ints, Floats]:
    """Return planes near points (n, 8), and the distances from them in standard deviations."""
    reach_m = KNOWN_CELLS * planes.cell_m
    of = Surfaces(planes).nearest(points, reach_m, 8)
    # One column for each plane of a point.
    of = np.sort(np.where(of < 0, len(planes), of), axis=1)
    of[:, 1:][of[:, 1:] == of[:, :-1]] = len(planes)
    normal, offset = np.vstack([planes.normal, np.zeros(3)]), np.append(planes.offset, np.inf)
    noise = np.append(planes.spread[:, 2], 1.0) + ROUNDING * planes.reach_m
    return of, np.abs(np.einsum("nki,ni->nk", normal[of], points) - offset[of]) / noise[of]


def _regions_in(points: Floats, size_m: float, sigma: float) -> list[Ints]:
    """Return the rows of points (n, 3) of each plane that grows in them."""
    if len(points) < FEWEST:
        return []
    voxels = uniform_voxels(points, size_m)
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
        rows = np.flatnonzero(off <= TRIM_SD * usual + ROUNDING * np.abs(points).max())
    return rows


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
    again = Submap()
    for k, iteration in enumerate(part.iteration):
        R, t = part.poses[k]
        mine = np.flatnonzero(scan == k)
        seen, which = part.scan(k), label[mine]
        for plane in np.unique(which[which >= 0]).tolist():
            seen = _appended(seen, seen.loose[which == plane], axes[plane, 0] @ R, sd[plane])
        seen = replace(seen, loose=seen.loose[which < 0])
        new = number + np.unique(which[which >= 0])
        again.add(iteration, seen, (R, t), np.append(part.number[part.match[k]], new))
    again.take_over(part, {})
    return again


def _appended(seen: Patches, points: Floats, normal: Floats, sd: float) -> Patches:
    """Return the patches of a scan and one more, of points (n, 3) on a plane with a normal."""
    centre = points.mean(axis=0)
    normal = -normal * np.sign(normal @ centre)
    off = points - centre
    sides = np.concatenate(across(normal[None]))
    along = off @ sides.T
    u = np.linalg.eigh(along.T @ along)[1][:, 1] @ sides
    axes = np.stack([u, np.cross(normal, u), normal])
    variance = ((off @ axes.T) ** 2).mean(axis=0)
    variance[2] = sd**2
    weight = len(points) / sd**2
    tilt = weight * np.maximum(variance[:2] - variance[2], 0.0)
    return replace(
        seen,
        centre=np.concatenate([seen.centre, centre[None]]),
        axes=np.concatenate([seen.axes, axes[None]]),
        information=np.concatenate([seen.information, np.append(tilt, weight)[None]]),
        spread=np.concatenate([seen.spread, np.sqrt(variance)[None]]),
        n_points=np.append(seen.n_points, len(points)),
        cells=np.concatenate([seen.cells, centre + along @ sides]),
        cell_patch=np.append(seen.cell_patch, np.full(len(points), len(seen))),
    )
