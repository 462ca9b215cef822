"""Edges of surfaces: they show where a scan is in a direction that planes leave open.

Of a wall with a door, floor and ceiling, none shows how far the sensor moved along the wall; the
door does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.scan import TINY
from relmap.planes3d.adjustment import across
from relmap.planes3d.placing import Placed
from relmap.planes3d.sights import FACING, cells_at
from relmap.planes3d.submap import Pose, Submap
from relmap.planes3d.surfaces import SIDE
from relmap.segmentation.space import Patches

ON_SD = 3.0
"""Points within this many standard deviations of a plane are on it."""
BEFORE = 8
"""Number of the last scans with whose edges those of a scan are compared."""
CROSSING = 0.5
"""Minimum cosine of the way across an edge and the direction in which it shows the position."""
FARTHEST, TRIED = 0.1, 8
"""Longest step to the edges, as a fraction of the range, and steps tried within their deviation."""
ENOUGH, CLEARLY = 8, 0.8
"""Minimum number of edges that agree on a step, and the largest fraction of the votes for it that
another one may have."""
Edges = tuple[Floats, Floats, Floats]


def edges_of(seen: Patches) -> Edges:
    """Return points (e, 3) on the edges of the surfaces of a scan, robot frame.

    Beside a ray that ends on a plane another one passes through it. Returns also the ways (e, 3)
    across the edges, to where nothing is, and the normals (e, 3) of the planes.
    """
    ends, none = seen.ends.astype(np.float64), np.empty((0, 3))
    range_m = np.linalg.norm(ends, axis=1)
    cell_m, found = cells_at(seen, range_m), [(none, none, none)]
    for normal, offset, sd in zip(seen.normal, seen.offset, seen.spread[:, 2], strict=True):
        along = ends @ normal
        facing = along < -FACING * range_m
        on = np.flatnonzero(facing & (np.abs(along - offset) < ON_SD * sd + TINY))
        past = np.flatnonzero(facing & (along < offset - cell_m))
        if not len(on) or not len(past):
            continue
        share = offset / along[past]
        through = share[:, None] * ends[past]
        off_m, at = map(np.asarray, cKDTree(through).query(ends[on]))
        here_m, there_m = cell_m[on], (share * cell_m[past])[at]
        near = np.flatnonzero((off_m > 0) & (off_m < here_m + there_m))
        way = through[at[near]] - ends[on[near]]
        # Each ray is half of the distance of the rays there away from the edge, on average.
        part = here_m[near] / (here_m + there_m)[near]
        edge = ends[on[near]] + part[:, None] * way
        found.append((edge, way / off_m[near, None], np.broadcast_to(normal, way.shape)))
    points, ways, normals = (np.concatenate(each) for each in zip(*found, strict=True))
    return points, ways, normals


def at_edges(placed: Placed, seen: Patches, part: Submap) -> Placed:
    """Return a placement moved to where the edges that a scan shows were seen before.

    It is moved along the direction that planes leave open, if most edges agree on how far.
    """
    if placed.free is None:
        return placed
    free, scans = placed.free, zip(part.seen[-BEFORE:], part.poses[-BEFORE:], strict=True)
    own, way, normal = _across(seen, placed.pose, free)
    before = [_across(each, pose, free) for each, pose in scans]
    there, their_way, facing = (np.concatenate(each) for each in zip(*before, strict=True))
    side = np.concatenate(across(free[None]))
    beside = cKDTree(own @ side.T).sparse_distance_matrix(
        cKDTree(there @ side.T), seen.cell_m, output_type="ndarray"
    )
    a, b = beside["i"], beside["j"]
    alike = (way[a] * their_way[b] > 0) & (np.einsum("ni,ni->n", normal[a], facing[b]) > SIDE)
    a, b = a[alike], b[alike]
    step_m = _agreed((there[b] - own[a]) @ free, a, FARTHEST * seen.reach_m, seen.cell_m / 2)
    return placed if step_m is None else replace(placed, t=placed.t + step_m * free)


def _across(seen: Patches, pose: Pose, free: Floats) -> Edges:
    """Return the edges of a scan across a direction, map frame; of their ways the cosines (e,)."""
    (R, t), (points, ways, normals) = pose, edges_of(seen)
    along = ways @ R.T @ free
    rows = np.abs(along) > CROSSING
    return points[rows] @ R.T + t, along[rows], normals[rows] @ R.T


def _agreed(steps_m: Floats, edge: Ints, far_m: float, near_m: float) -> float | None:
    """Return the step that most of some steps (n,) are near; None if few are, or another has many.

    `edge` (n,): the edge of the scan that implies each; `far_m`, `near_m`: longest step, and
    standard deviation of a step.
    """
    tried = np.linspace(-far_m, far_m, 2 * int(TRIED * far_m / near_m) + 1)
    votes = np.exp(-(((steps_m - tried[:, None]) / near_m) ** 2) / 2).sum(axis=1)
    best = int(votes.argmax())
    agree = np.unique(edge[np.abs(steps_m - tried[best]) < 2 * near_m])
    others = votes[np.abs(tried - tried[best]) > 3 * near_m]
    if len(agree) < ENOUGH or others.max(initial=0.0) > CLEARLY * votes[best]:
        return None
    return float(tried[best])
