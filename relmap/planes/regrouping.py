"""Which tracks are one wall, looked at once more where the refined map has put the scans.

While loops are closed and walls joined some tracks come to belong to a wall that they do not lie
on.  Such a track is set free; if it lies on another wall it is part of that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from relmap.planes.assembly import Assembled, WallNumbers, assemble, directions
from relmap.planes.history import PlaneHistory
from relmap.planes.joining import (
    OVERLAP,
    joined_corners,
    placed_ends,
    seen_together,
    wall_extents,
)
from relmap.planes.submaps import WallSubmap, among_all

SCATTER_M, SCATTER, MOSTLY = 0.08, 6.0, 0.75
"""A track moved that is farther from its own line, and by more typical distances, in more than a
quarter of its sights."""
SLID_M = 0.25
"""Likewise a corner along that line."""
TURN = np.cos(np.deg2rad(15.0))
ACROSS_M, ACROSS = 0.06, 3.0
"""How far from a wall both ends of another are that is part of it: metres, or typical distances."""
GAP_M = 0.2
"""How far beyond its end."""
TIMES = 2
"""How often walls are gathered: tracks, and then what they came to be."""


def regrouped(
    submap: WallSubmap, numbers: WallNumbers, history: PlaneHistory, moving: NDArray[np.bool_]
) -> tuple[Assembled, WallNumbers, NDArray[np.int64]]:
    """Return the walls of a submap that its tracks lie on, where its poses put them.

    Parameters
    ----------
    submap : WallSubmap
        With walls.
    numbers : WallNumbers
        Who is who in it.
    history : PlaneHistory
    moving : (p,) bool
        Plane tracks that move.

    Returns
    -------
    assembled : Assembled
    numbers : WallNumbers
    moved : (m,) int64
        Tracks that moved, which are not among the walls.
    """
    given = submap.assembled
    assert given is not None
    moved, flat_m = _scattered(given, history)
    still = moving.copy()
    still[moved] = True
    poses = among_all(submap.poses, submap.span, history)
    wall_of = numbers.wall_of.copy()
    tracks = np.unique(history.plane[given.rows])
    wall_of[tracks] = tracks
    for _ in range(TIMES):
        found = _with_corners(wall_of, numbers.corner_of, history)
        laid = assemble(history, found, poses, still)
        if laid is None:
            return given, numbers, moved
        wall_of = _gathered(laid, wall_of, max(ACROSS_M, ACROSS * flat_m))
    found = _with_corners(wall_of, numbers.corner_of, history)
    every = assemble(history, found, poses, still)
    assert every is not None
    corner_of = joined_corners(every, np.arange(len(every.walls)))
    joined = np.where(found.corner_of < 0, -1, corner_of[found.corner_of])
    found = WallNumbers(found.wall_of, joined)
    again = assemble(history, found, poses, still)
    assert again is not None
    return _as_refined(again, given), found, moved


def _with_corners(
    wall_of: NDArray[np.int64], corner_of: NDArray[np.int64], history: PlaneHistory
) -> WallNumbers:
    """Return who is who with the corners that are one, unless they are now of two walls."""
    wall = np.zeros(len(corner_of), dtype=np.int64)
    row, end = np.nonzero(history.corner >= 0)
    wall[history.corner[row, end]] = wall_of[history.plane[row]]
    own = np.arange(len(corner_of))
    same = (corner_of < 0) | (wall == wall[corner_of])
    return WallNumbers(wall_of, np.where(same, corner_of, own))


def _scattered(assembled: Assembled, history: PlaneHistory) -> tuple[NDArray[np.int64], float]:
    """Return the tracks that do not keep to lines of their own, and how flat the others are.

    Or whose corners move along the line.  That is the median distance from it, metres.
    """
    from relmap.core.linalg.order_kernels import medians, quantiles

    given, track = assembled.given, history.plane[assembled.rows]
    tracks, of = np.unique(track, return_inverse=True)
    ends = placed_ends(assembled)
    x, y = (np.bincount(of, axis) for axis in (ends[:, 1] - ends[:, 0]).T)
    normal, along = (each[of] for each in directions(np.arctan2(x, -y)))
    across = np.einsum("nei,ni->ne", ends, normal)
    off = np.abs(across - medians(of, across.mean(axis=1))[of][:, None]).max(axis=1)
    flat_m = float(np.median(off))
    row, end = given.corner_row, given.corner_end
    corners, corner = np.unique(history.corner[assembled.rows[row], end], return_inverse=True)
    place = (ends[row, end] * along[row]).sum(axis=1)
    slid = np.abs(place - medians(corner, place)[corner])
    owner = np.zeros(len(corners), dtype=np.int64)
    owner[corner] = track[row]
    limit = max(SCATTER_M, SCATTER * flat_m)
    moved = quantiles(of, off, MOSTLY) > limit
    slides = quantiles(corner, slid, MOSTLY) > max(SLID_M, limit)
    return np.union1d(tracks[moved], owner[slides]), flat_m


def _gathered(
    assembled: Assembled, wall_of: NDArray[np.int64], across_m: float
) -> NDArray[np.int64]:
    """Return who is who among walls (p,) with those that lie on a larger one part of it."""
    state = assembled.state
    normal, along = directions(state.angle)
    base = state.centre + state.across[:, None] * normal
    low, high = wall_extents(assembled)
    middle, half = (low + high) / 2, np.maximum(high - low, 0.0) / 2
    base, low, high = base + middle[:, None] * along, -half, half
    sights = np.bincount(assembled.given.wall, minlength=len(base))
    part = np.arange(len(base))
    ends = base[:, None] + np.stack([low, high], axis=1)[:, :, None] * along[:, None]
    order = np.argsort(-sights * (half + 0.1), kind="stable")
    ends_there = np.zeros((len(base), 2), dtype=np.bool_)
    given = assembled.given
    ends_there[given.wall[given.corner_row], given.corner_end] = True
    together = seen_together(assembled)
    taken = np.zeros(len(base), dtype=np.bool_)
    for k in order.tolist():
        rows = np.flatnonzero(taken & (normal @ normal[k] > TURN))
        offset = ends[k][None] - base[rows][:, None]
        off = np.abs(np.einsum("nei,ni->ne", offset, normal[rows])).max(axis=1)
        place = np.einsum("nei,ni->ne", offset, along[rows])
        right, left = place[:, 0] - high[rows], low[rows] - place[:, 1]
        gap_m = np.where(ends_there[k, 0] | ends_there[rows, 1], -GAP_M, GAP_M)
        fits = (off <= across_m) & (right <= gap_m)
        gap_m = np.where(ends_there[k, 1] | ends_there[rows, 0], -GAP_M, GAP_M)
        fits &= left <= gap_m
        inside = np.minimum(place[:, 1], high[rows]) - np.maximum(place[:, 0], low[rows])
        beside = np.isin(rows, together.indices[together.indptr[k] : together.indptr[k + 1]])
        fits |= (off <= 2 * across_m) & (inside > OVERLAP * 2 * half[k]) & ~beside
        if not fits.any():
            taken[k] = True
            continue
        best = int(np.argmin(np.where(fits, off, np.inf)))
        wall = rows[best]
        part[k] = wall
        low[wall] = min(low[wall], place[best, 0])
        high[wall] = max(high[wall], place[best, 1])
    renamed = np.arange(len(wall_of))
    renamed[assembled.walls] = assembled.walls[part]
    wall_of = renamed[wall_of]
    _, first, of = np.unique(wall_of, return_index=True, return_inverse=True)
    return np.asarray(first[of])


def _as_refined(again: Assembled, before: Assembled) -> Assembled:
    """Return walls laid out anew, those of which nothing changed as they were refined."""
    size = max(int(again.walls.max(initial=0)), int(before.walls.max(initial=0))) + 1
    sums = []
    for each in (again, before):
        wall = each.walls[each.given.wall]
        sums.append((np.bincount(wall, minlength=size), np.bincount(wall, each.rows, size)))
    same = (sums[0][0] == sums[1][0]) & (sums[0][1] == sums[1][1]) & (sums[0][0] > 0)
    walls = np.flatnonzero(same[again.walls])
    old = np.searchsorted(before.walls, again.walls[walls])
    state, refined = again.state, before.state
    centre, angle, across = state.centre.copy(), state.angle.copy(), state.across.copy()
    centre[walls], angle[walls] = refined.centre[old], refined.angle[old]
    across[walls] = refined.across[old]
    moved = ((state.centre - centre) * directions(angle)[1]).sum(axis=1)
    along = state.along + moved[again.corner_wall]
    kept = np.isin(again.corner_wall, walls) & np.isin(again.corners, before.corners)
    along[kept] = refined.along[np.searchsorted(before.corners, again.corners[kept])]
    laid = replace(state, centre=centre, angle=angle, across=across, along=along)
    return replace(again, state=laid)
