"""Reassignment of tracks to walls at the refined poses of the scans.

During loop closure and joining, some tracks are assigned to walls that they do not lie on. So every
track is reassigned to the wall that it lies on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Bools, Ints
from relmap.planes.submaps.submap import WallSubmap, among_all
from relmap.planes.walls.assembly import Assembled, WallNumbers, assemble, directions, laid_out
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.joining import joined_corners, placed_ends, seen_together, wall_extents

SCATTER_M, SCATTER, MOSTLY = 0.08, 6.0, 0.75
"""A track moved if more than a quarter of its observations are farther from its line than this, in
metres and in typical distances."""
SLID_M = 0.25
"""The same for a corner along that line."""
TURN = np.cos(np.deg2rad(15.0))
ACROSS_M, ACROSS = 0.06, 3.0
"""Largest distance of both ends of a wall from another that it is part of: metres, and typical
distances. Twice as far if they overlap and no scan showed both."""
GAP_M = 0.2
"""Largest distance beyond its end; if either has a corner there, required overlap."""
TIMES = 2
"""Number of rounds of gathering: tracks first, then the resulting walls."""


def regrouped(
    submap: WallSubmap, numbers: WallNumbers, history: PlaneHistory, moving: Bools
) -> tuple[Assembled, WallNumbers, Ints]:
    """Return the walls of a submap from its tracks, at the submap's poses.

    `submap`: with walls; `numbers`: its association; `moving` (p,): plane tracks that move. Returns
    `moved` (m,): tracks that moved, which are not among the walls.
    """
    given = submap.assembled
    assert given is not None
    moved, flat_m = _moved(given, history)
    still, tracks = moving.copy(), np.unique(history.plane[given.rows])
    still[moved] = True
    poses = among_all(submap.poses, submap.span, history)
    wall_of = numbers.wall_of.copy()
    wall_of[tracks] = tracks
    for _ in range(TIMES):
        found = _with_corners(wall_of, numbers.corner_of, history)
        laid = assemble(history, found, poses, still)
        if laid is None:
            return given, numbers, moved
        wall_of = _gathered(laid, wall_of, max(ACROSS_M, ACROSS * flat_m))
    found = _with_corners(wall_of, numbers.corner_of, history)
    laid = assemble(history, found, poses, still)
    assert laid is not None
    corner_of = joined_corners(laid, found.corner_of, np.arange(len(laid.walls)))
    found = WallNumbers(found.wall_of, corner_of)
    again = assemble(history, found, poses, still)
    assert again is not None
    again = _as_noisy(again, given)
    state = laid_out(again.given, poses[again.iterations])
    return _as_refined(replace(again, state=state), given), found, moved


def _with_corners(wall_of: Ints, corner_of: Ints, history: PlaneHistory) -> WallNumbers:
    """Return the association with identical corners merged, unless they now belong to two walls."""
    wall = np.zeros(len(corner_of), dtype=np.int64)
    row, end = np.nonzero(history.corner >= 0)
    wall[history.corner[row, end]] = wall_of[history.plane[row]]
    same = (corner_of < 0) | (wall == wall[corner_of])
    return WallNumbers(wall_of, np.where(same, corner_of, np.arange(len(corner_of))))


def _moved(assembled: Assembled, history: PlaneHistory) -> tuple[Ints, float]:
    """Return the tracks that do not keep to their lines, or whose corners slide along them.

    Also returns the usual distance of a wall from its line, metres.
    """
    from relmap.core.linalg.order_kernels import medians, quantiles

    given, track = assembled.given, history.plane[assembled.rows]
    tracks, of = np.unique(track, return_inverse=True)
    ends = placed_ends(assembled)
    x, y = (np.bincount(of, axis) for axis in (ends[:, 1] - ends[:, 0]).T)
    normal, along = (each[of] for each in directions(np.arctan2(x, -y)))
    across = np.einsum("nei,ni->ne", ends, normal)
    off = np.abs(across - medians(of, across.mean(axis=1))[of][:, None]).max(axis=1)
    row, end = given.corner_row, given.corner_end
    corners, corner = np.unique(history.corner[assembled.rows[row], end], return_inverse=True)
    place = (ends[row, end] * along[row]).sum(axis=1)
    slid = np.abs(place - medians(corner, place)[corner])
    owner = np.zeros(len(corners), dtype=np.int64)
    owner[corner] = track[row]
    flat_m = float(np.median(off))
    limit_m = max(SCATTER_M, SCATTER * flat_m)
    scattered = quantiles(of, off, MOSTLY) > limit_m
    slides = quantiles(corner, slid, MOSTLY) > max(SLID_M, limit_m)
    return np.union1d(tracks[scattered], owner[slides]), flat_m


def _gathered(assembled: Assembled, wall_of: Ints, across_m: float) -> Ints:
    """Return the association of tracks (p,), with walls that lie on a larger one assigned to it."""
    from relmap.planes.plan.plan_kernels import gathered

    state, given = assembled.state, assembled.given
    normal, along = directions(state.angle)
    low, high = wall_extents(assembled)
    middle = state.centre + state.across[:, None] * normal + (low + high)[:, None] / 2 * along
    half = np.maximum(high - low, 0.0) / 2
    has_corner = np.zeros((len(half), 2), dtype=np.bool_)
    has_corner[given.wall[given.corner_row], given.corner_end] = True
    order = np.argsort(-np.bincount(given.wall) * (half + GAP_M), kind="stable")
    lines = middle, normal, along, np.column_stack([-half, half]), has_corner
    seen = seen_together(assembled)
    part = gathered(lines, (seen.indptr, seen.indices), order, across_m)
    renamed = np.arange(len(wall_of))
    renamed[assembled.walls] = assembled.walls[part]
    _, first, of = np.unique(renamed[wall_of], return_index=True, return_inverse=True)
    return np.asarray(first[of])


def _as_noisy(again: Assembled, before: Assembled) -> Assembled:
    """Return walls with the noise of each observation learnt earlier."""
    old, given = before.given, again.given
    sd, corner_sd = given.sd.copy(), given.corner_sd.copy()
    _, there, at = np.intersect1d(again.rows, before.rows, return_indices=True)
    sd[there] = old.sd[at]
    keys, old_keys = (
        2 * each.rows[each.given.corner_row] + each.given.corner_end for each in (again, before)
    )
    _, there, at = np.intersect1d(keys, old_keys, return_indices=True)
    corner_sd[there] = old.corner_sd[at]
    return replace(again, given=replace(given, sd=sd, corner_sd=corner_sd))


def _as_refined(again: Assembled, before: Assembled) -> Assembled:
    """Return newly averaged walls; those with unchanged observations keep their refined state."""
    size = 1 + int(max(again.walls.max(initial=0), before.walls.max(initial=0)))
    counts, sums = np.zeros((2, size)), np.zeros((2, size))
    for k, each in enumerate((again, before)):
        wall = each.walls[each.given.wall]
        counts[k] = np.bincount(wall, minlength=size)
        sums[k] = np.bincount(wall, each.rows, minlength=size)
    same = (counts[0] == counts[1]) & (sums[0] == sums[1])
    walls = np.flatnonzero(same[again.walls])
    old = np.searchsorted(before.walls, again.walls[walls])
    state, refined = again.state, before.state
    centre, angle, across = state.centre.copy(), state.angle.copy(), state.across.copy()
    centre[walls], angle[walls] = refined.centre[old], refined.angle[old]
    across[walls] = refined.across[old]
    # Corners keep their refined position, or the average of their observations, along their walls.
    wall, at = again.corner_wall, again.corner_at
    kept = np.isin(again.corners, before.corners)
    at[kept] = before.corner_at[np.searchsorted(before.corners, again.corners[kept])]
    along = ((at - centre[wall]) * directions(angle[wall])[1]).sum(axis=1)
    laid = replace(state, centre=centre, angle=angle, across=across, along=along)
    return replace(again, state=laid)
