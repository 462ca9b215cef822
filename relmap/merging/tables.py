"""Merging two tables, of landmarks or of walls, in one frame."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import one_to_one
from relmap.core.landmarks import LandmarkTable
from relmap.evaluation.pairing import moved
from relmap.planes.places.wall_tie import NEAR_M, SAMPLE_M, WallPoints, WallTie, lying
from relmap.planes.walls.table import PlaneTable

MOST = 0.5
"""Fraction of the shorter of two walls that must overlap if they are one."""
COVERED = 0.8
"""Fraction of a wall covered by other walls above which it is redundant."""
COMBINED = {
    "observations": np.add,
    "first_iteration": np.minimum,
    "last_iteration": np.maximum,
    "level": np.maximum,
}
"""How columns of merged landmarks are combined."""


def lying_on(ends: Floats, others: Floats) -> Floats:
    """Return the length of walls (w, 2, 2) that overlaps each of others (v, 2, 2); (w, v)."""
    length_m = np.zeros((len(ends), len(others)))
    if not (len(ends) and len(others)):
        return length_m
    points, among = WallPoints.of(ends), WallPoints.of(others)
    other, _ = lying(points, among, WallTie(np.eye(2), np.zeros(2), 0.0), NEAR_M)
    on = other >= 0
    np.add.at(length_m, (points.wall[on], among.wall[other[on]]), SAMPLE_M)
    return length_m


def moved_walls(table: PlaneTable, T: Floats) -> PlaneTable:
    """Return walls transformed by a motion (4, 4) into the frame of another map."""
    ends = moved(table.ends.reshape(-1, 2), T).reshape(-1, 2, 2)
    return replace(table, ends=ends, normal=table.normal @ T[:2, :2].T)


def joined_walls(one: PlaneTable, other: PlaneTable) -> tuple[PlaneTable, Ints]:
    """Merge two tables with walls in one frame and distinct corner numbers.

    Overlapping walls are merged: the line is their average, weighted by the number of observations,
    and the extent is the union. Other walls of `other` that are mostly covered by walls of `one`
    are left out. Walls of `one` keep their numbers. Returns `corners` (k, 2): corners of `other`
    and of `one` that are one; they keep the number from `one`.
    """
    own, new = (np.flatnonzero(table.status == "static") for table in (one, other))
    lying_m = lying_on(other.ends[new], one.ends[own])
    length_m = [np.hypot(*(t.ends[k, 1] - t.ends[k, 0]).T) for t, k in ((one, own), (other, new))]
    due = lying_m >= MOST * np.minimum(length_m[1][:, None], length_m[0][None])
    theirs, mine = np.nonzero(due & (lying_m > 0))
    apart = np.column_stack([theirs, len(new) + mine])  # distinct numbers
    partners = one_to_one(apart, -lying_m[theirs, mine]) - [0, len(new)]
    columns = {name: column.copy() for name, column in vars(one).items()}
    corners = list[tuple[int, int]]()
    for k, m in partners.tolist():
        corners += _join(columns, int(own[m]), other, int(new[k]))
    gone = np.zeros(len(other.plane), dtype=np.bool_)
    gone[new[lying_m.sum(axis=1) >= COVERED * length_m[1]]] = True
    gone[new[partners[:, 0]]] = True
    rest = replace(other, plane=other.plane + (int(one.plane.max(initial=-1)) + 1))
    for name, column in columns.items():
        columns[name] = np.concatenate([column, getattr(rest, name)[~gone]])
    return PlaneTable(**columns), np.array(corners, dtype=np.int64).reshape(-1, 2)


def _join(
    columns: dict[str, NDArray[Any]], mine: int, other: PlaneTable, k: int
) -> list[tuple[int, int]]:
    """Merge a wall of another table into a row of the columns; return the merged corners."""
    ends = np.stack([columns["ends"][mine], other.ends[k]])
    seen = np.array([columns["observations"][mine], other.observations[k]], dtype=np.float64)
    weight = seen / max(seen.sum(), 1.0)
    way = ends[:, 1] - ends[:, 0]
    along = weight @ (way / np.hypot(*way.T)[:, None])
    along /= np.hypot(*along)
    normal = np.array([-along[1], along[0]])
    base = weight @ (ends.mean(axis=1) @ normal)
    reach = ends @ along
    farthest = np.array([np.argmin(reach[:, 0]), np.argmax(reach[:, 1])])
    at = reach[farthest, [0, 1]]
    columns["ends"][mine] = base * normal + at[:, None] * along
    columns["normal"][mine] = normal
    corner = np.stack([columns["corner"][mine], other.corner[k]])
    both = (corner >= 0).all(axis=0)
    columns["corner"][mine] = np.where(both, corner[0], corner[farthest, [0, 1]])
    z = np.stack([columns["z_extent"][mine], other.z_extent[k]])
    columns["z_extent"][mine] = z[:, 0].min(), z[:, 1].max()
    for name in columns.keys() & COMBINED:
        columns[name][mine] = COMBINED[name](columns[name][mine], getattr(other, name)[k])
    return [(int(theirs), int(own)) for own, theirs in corner.T[both].tolist()]


def joined(one: LandmarkTable, other: LandmarkTable, pairs: Ints) -> LandmarkTable:
    """Merge two tables with positions in one frame and distinct labels.

    `pairs` (k, 2): rows of `other` and of `one` that are one landmark, which keeps the label from
    `one`. Positions are averaged, weighted by their variances if both are known, otherwise by the
    number of observations; if one is unmapped, the other stands.
    """
    theirs, mine = pairs.T
    columns = {name: column.copy() for name, column in vars(one).items()}
    lost = np.isnan(one.position[mine, 0])
    for name, column in columns.items():
        if name != "landmark":
            column[mine[lost]] = getattr(other, name)[theirs[lost]]
    for name, of in COMBINED.items():
        columns[name][mine] = of(getattr(one, name)[mine], getattr(other, name)[theirs])
    theirs, mine = pairs[~lost & np.isfinite(other.position[theirs, 0])].T
    a, b = one.sd[mine] ** 2, other.sd[theirs] ** 2
    seen = one.observations[mine], other.observations[theirs]
    known, by_count = (a > 0) & (b > 0), seen[1] / np.maximum(seen[0] + seen[1], 1)
    share = np.where(known, a / np.where(known, a + b, 1.0), by_count)
    away = other.position[theirs] - one.position[mine]
    columns["position"][mine] += share[:, None] * away
    columns["sd"][mine] = np.hypot((1 - share) * one.sd[mine], share * other.sd[theirs])
    rest = np.setdiff1d(np.arange(len(other.landmark)), pairs[:, 0])
    for name, column in columns.items():
        columns[name] = np.concatenate([column, getattr(other, name)[rest]])
    return LandmarkTable(**columns)
