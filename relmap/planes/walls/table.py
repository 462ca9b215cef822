"""The table of walls: one row per wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup, in_space
from relmap.core.shown import Table
from relmap.planes.walls.assembly import OFTEN, Assembled, WallNumbers, directions
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.joining import wall_extents


@dataclass(frozen=True, eq=False, repr=False)
class PlaneTable(Table):
    """Every wall ever seen, one row each, in ascending order of numbers.

    Attributes
    ----------
    plane : (n,) int64
    ends : (n, 2, 2) float64, map frame, metres
        x, y of its right and left end as seen from its front; NaN if unmapped.
    z_extent : (n, 2) float64, metres
        Lowest and highest z.
    normal : (n, 2) float64
        Unit vector to the front.
    corner : (n, 2) int64
        The corner at either end; -1 if the end was never static.
    observations : (n,) int64
    first_iteration, last_iteration : (n,) int64
    status : (n,) str
        "static", "dynamic" or "unmapped".
    """

    plane: Ints
    ends: Floats
    z_extent: Floats
    normal: Floats
    corner: Ints
    observations: Ints
    first_iteration: Ints
    last_iteration: Ints
    status: NDArray[np.str_]


def plane_table(
    history: PlaneHistory, numbers: WallNumbers, assembled: Assembled | None, moving: Bools
) -> PlaneTable:
    """Return the table of all walls.

    `assembled`: the mapped walls; `moving` (p,): plane tracks that were seen moving.
    """
    plane, row = np.unique(numbers.wall_of[history.plane], return_inverse=True)
    n = len(plane)
    count, first, last = _sightings(row, history.iteration, n)
    z = np.column_stack(
        [np.bincount(row, axis, minlength=n) / np.maximum(count, 1) for axis in history.z_extent.T]
    )
    ends, normal = np.full((n, 2, 2), np.nan), np.full((n, 2), np.nan)
    corner = np.full((n, 2), -1)
    status = np.where(np.isin(plane, numbers.wall_of[moving]), "dynamic", "unmapped")
    if assembled is not None:
        often = _often(assembled)
        at = np.searchsorted(plane, assembled.walls[often])
        ends[at], normal[at], corner[at] = (part[often] for part in _mapped(assembled))
        status[at] = "static"
    return PlaneTable(plane, ends, z, normal, corner, count, first, last, status)


def _sightings(of: Ints, iteration: Ints, n: int) -> tuple[Ints, Ints, Ints]:
    """Return count, first and last iteration for each of n; iterations (k,) ascend."""
    first, last = np.zeros((2, n), dtype=np.int64)
    first[of[::-1]], last[of] = iteration[::-1], iteration
    return np.bincount(of, minlength=n), first, last


def _mapped(assembled: Assembled) -> tuple[Floats, Floats, Ints]:
    """Return ends, normals and corners of the mapped walls."""
    state = assembled.state
    normal, along = directions(state.angle)
    reach = assembled.reach
    reach = np.column_stack(wall_extents(assembled)) if reach is None else reach.copy()
    at_end = _at_ends(assembled)
    wall, end = np.nonzero(at_end >= 0)
    compact = at_end[wall, end]
    corner = np.full(reach.shape, -1)
    reach[wall, end], corner[wall, end] = state.along[compact], assembled.corners[compact]
    base = state.centre + state.across[:, None] * normal
    return base[:, None] + reach[:, :, None] * along[:, None], normal, corner


def _often(assembled: Assembled) -> Bools:
    """Return which walls (w,) were seen often enough to be mapped."""
    given = assembled.given
    return np.asarray(np.bincount(given.wall, minlength=len(assembled.walls)) >= OFTEN)


def _at_ends(assembled: Assembled) -> Ints:
    """Return the corner (w, 2) at either end of each wall, in compact numbers; -1 for none."""
    given = assembled.given
    corner = np.full((len(assembled.walls), 2), -1)
    end = np.zeros(len(assembled.corners), dtype=np.int64)
    end[given.corner] = given.corner_end
    seen = np.bincount(given.corner, minlength=len(assembled.corners))
    wall = assembled.corner_wall
    for k in np.argsort(seen, kind="stable").tolist():  # most observations last
        corner[wall[k], end[k]] = k
    return corner


def mapped_corners(assembled: Assembled) -> Ints:
    """Return the corners (k,), compact and ascending, that are an end of a mapped wall."""
    at_end = _at_ends(assembled)[_often(assembled)]
    return np.unique(at_end[at_end >= 0])


def corner_map(assembled: Assembled | None, spread: Floats | None) -> LandmarkMap:
    """Return the mapped corners, in ascending order of their numbers.

    `spread` (c, 2, 2): covariances of all corners, square metres, if known.
    """
    if assembled is None:
        return LandmarkMap(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    mapped = mapped_corners(assembled)
    covariances = np.zeros((0 if spread is None else len(mapped), 3, 3))
    if spread is not None:
        covariances[:, :2, :2] = spread[mapped]
    return LandmarkMap(
        assembled.corners[mapped], in_space(assembled.corner_at[mapped]), covariances
    )


def corner_table(
    history: PlaneHistory,
    numbers: WallNumbers,
    submaps: list[Assembled | None],
    moving: Ints,
    spread: Floats | None,
) -> LandmarkTable:
    """Return the table of all corners, except ends that turned out not to be corners.

    `submaps`: the corners of each submap; those of the first are mapped. `moving` (k,): corners
    that were seen moving. `spread` (c, 2, 2): covariances of all corners of the first submap,
    square metres, if known.
    """
    row, end = np.nonzero(history.corner >= 0)
    own = history.corner[row, end]
    corner = np.where(np.isin(own, moving), own, numbers.corner_of[own])
    row, corner = row[corner >= 0], corner[corner >= 0]
    label, at = np.unique(corner, return_inverse=True)
    n = len(label)
    count, first, last = _sightings(at, history.iteration[row], n)
    position, sd = np.full((n, 3), np.nan), np.full(n, np.nan)
    status = np.where(np.isin(label, moving), "dynamic", "unmapped")
    level, submap = np.zeros(n, dtype=np.int64), np.full(n, -1)
    for number, assembled in enumerate(submaps):
        if assembled is None:
            continue
        mapped = mapped_corners(assembled)
        there = np.searchsorted(label, assembled.corners[mapped])
        submap[there] = number
        if number > 0:
            continue
        position[there] = in_space(assembled.corner_at[mapped])
        sd[there] = assembled.corner_sd[mapped]
        if spread is not None:
            sd[there] = np.sqrt(np.trace(spread[mapped], axis1=1, axis2=2) / 2)
        status[there], level[there] = "static", 3
    return LandmarkTable(
        landmark=label,
        position=position,
        sd=sd,
        observations=count,
        first_iteration=first,
        last_iteration=last,
        level=level,
        status=status,
        submap=submap,
        moving_bin=np.full(n, -1),
    )


def corner_group(group: MappedGroup, corner: Ints) -> MappedGroup:
    """Return a group of corners without midpoints, by the numbers of corners.

    `group`: group of landmarks numbered as by `PlaneRegistration`. `corner` (k,): number of each
    corner; -1 if it turned out to be none.
    """
    number = np.where(group.landmarks % 2 == 0, corner[group.landmarks // 2], -1)
    own = number >= 0
    return MappedGroup(
        number[own], group.relative_map[own], group.n_observations[own], group.iterations
    )
