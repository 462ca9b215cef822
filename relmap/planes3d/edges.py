"""Edges of surfaces: they show where a scan is in a direction that planes leave open.

Of a wall with a door, floor and ceiling, none shows how far the sensor moved along the wall; the
door does. If it has none, objects too small or too round for planes do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints, evenly
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
LOOSE, BESIDE, FURTHER, FINE = 300, 8, 4.0, 0.045
"""Number of the points on no plane whose edges are looked for, number of the nearest rays that are
tried for each, and how many cells farther these must go; and the size of cells, as a fraction of
the range, above which neighbouring rays are too far apart for that: they are larger where points
are sparse."""
ALONG = 1e-3
"""Distance of two rays, in cells, below which they are one: then there is no way across an edge."""
Edges = tuple[Floats, Floats, Floats]


@lru_cache(maxsize=2 * BEFORE)  # Of each scan they are needed for itself and the next ones.
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


@lru_cache(maxsize=2 * BEFORE)
def edges_of_loose(seen: Patches) -> Edges:
    """Return the edges of what is on no plane: beside a ray that ends there another goes on.

    As of `edges_of`; the normals point to the sensor.
    """
    ends = seen.ends.astype(np.float64)
    rows = evenly(len(seen.loose), LOOSE if seen.cell_m < FINE * seen.reach_m else 0)
    loose = seen.loose[rows][seen.loose[rows].any(axis=1)]
    away_m, range_m = (np.linalg.norm(each, axis=1, keepdims=True) for each in (loose, ends))
    ray = loose / away_m
    off, at = map(np.asarray, cKDTree(ends / range_m).query(ray, k=BESIDE))
    range_m, here_m = np.append(range_m, 0.0)[at], cells_at(seen, away_m)
    there_m = cells_at(seen, range_m) * away_m / np.maximum(range_m, TINY)
    near = (off * away_m > ALONG * here_m) & (off * away_m < here_m + there_m)
    one, other = np.nonzero(near & (range_m > away_m + FURTHER * here_m))
    range_m, there_m = range_m[one, other, None], there_m[one, other, None]
    way = away_m[one] / range_m * ends[at[one, other]] - loose[one]
    edge = loose[one] + here_m[one] / (here_m[one] + there_m) * way
    return edge, way / np.linalg.norm(way, axis=1, keepdims=True), -ray[one]


def at_edges(placed: Placed, seen: Patches, part: Submap) -> Placed:
    """Return a placement moved to where the edges that a scan shows were seen before.

    It is moved along the direction that planes leave open, if most edges of planes agree on how
    far, or else most of what is on no plane.
    """
    if placed.free is None:
        return placed
    for edges in edges_of, edges_of_loose:
        step_m = _agreed(*_steps(placed, placed.free, seen, part, edges), seen)
        if step_m is not None:
            return replace(placed, t=placed.t + step_m * placed.free)
    return placed


def _steps(
    placed: Placed, free: Floats, seen: Patches, part: Submap, edges: Callable[[Patches], Edges]
) -> tuple[Floats, Ints]:
    """Return the steps (n,) along a direction that lead from edges of a scan to those before.

    With the edge (n,) of the scan that each starts from.
    """
    own, way, normal = _across(edges(seen), placed.pose, free)
    side, found = np.concatenate(across(free[None])), []
    for each, pose in zip(part.seen[-BEFORE:], part.poses[-BEFORE:], strict=True):
        there, their_way, facing = _across(edges(each), pose, free)
        beside = cKDTree(own @ side.T).sparse_distance_matrix(
            cKDTree(there @ side.T), seen.cell_m, output_type="ndarray"
        )
        a, b = beside["i"], beside["j"]
        alike = (way[a] * their_way[b] > 0) & (np.einsum("ni,ni->n", normal[a], facing[b]) > SIDE)
        found.append((((there[b] - own[a]) @ free)[alike], a[alike]))
    steps_m, edge = (np.concatenate(each) for each in zip(*found, strict=True))
    return steps_m, edge


def _across(edges: Edges, pose: Pose, free: Floats) -> Edges:
    """Return those of some edges across a direction, map frame; of their ways the cosines (e,)."""
    (R, t), (points, ways, normals) = pose, edges
    along = ways @ R.T @ free
    rows = np.abs(along) > CROSSING
    return points[rows] @ R.T + t, along[rows], normals[rows] @ R.T


def _agreed(steps_m: Floats, edge: Ints, seen: Patches) -> float | None:
    """Return the step that most of some steps (n,) are near; None if few are, or another has many.

    `edge` (n,): the edge of the scan that implies each. A step is as accurate as half a cell.
    """
    far_m, near_m = FARTHEST * seen.reach_m, seen.cell_m / 2
    tried = np.linspace(-far_m, far_m, 2 * int(TRIED * far_m / near_m) + 1)
    votes = np.exp(-(((steps_m - tried[:, None]) / near_m) ** 2) / 2).sum(axis=1)
    best = int(votes.argmax())
    agree = np.unique(edge[np.abs(steps_m - tried[best]) < 2 * near_m])
    others = votes[np.abs(tried - tried[best]) > 3 * near_m]
    if len(agree) < ENOUGH or others.max(initial=0.0) > CLEARLY * votes[best]:
        return None
    return float(tried[best])
