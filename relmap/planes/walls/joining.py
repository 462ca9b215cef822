"""Joining walls seen again: tracks that coincide in the refined map are one wall.

Corners associate walls after drift (`merging`). Without drift lines suffice: two tracks with the
same normal and offset that overlap along the wall are the same wall, with or without corners.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array

from relmap.core.arrays import Floats, Ints
from relmap.planes.walls.assembly import Assembled, WallNumbers, directions, placed
from relmap.planes.walls.history import first_of

TURN_RAD = np.deg2rad(6.0)
ACROSS_M = 0.15
BESIDE_M = 0.05
"""The same for two that were seen in one scan."""
OVERLAP = 0.3
"""Fraction of the shorter one that must overlap the longer one."""
BLOCK = 256
"""Walls compared with all others at a time."""
CORNER_M = 0.35
"""Largest distance between two corners at one end of a wall."""
BEYOND_M = 0.3
"""A wall that is mostly seen to continue this far beyond a corner has no corner there."""
OUTLYING = 0.05
"""Fraction of the observations of a wall that extend beyond its end."""


def join_walls(assembled: Assembled, numbers: WallNumbers) -> WallNumbers:
    """Return the association with collinear tracks joined, and false corners removed (-1)."""
    low, high = wall_extents(assembled)
    first = first_of(len(assembled.walls), _pairs(assembled, low, high))
    return WallNumbers(
        _renamed(assembled, numbers, first), joined_corners(assembled, numbers.corner_of, first)
    )


def join_pairs(assembled: Assembled, numbers: WallNumbers, pairs: Ints) -> WallNumbers:
    """Return the association after merging pairs (k, 2) of compact wall numbers."""
    first = first_of(len(assembled.walls), pairs)
    return WallNumbers(_renamed(assembled, numbers, first), numbers.corner_of)


def _renamed(assembled: Assembled, numbers: WallNumbers, first: Ints) -> Ints:
    renamed = np.arange(len(numbers.wall_of))
    renamed[assembled.walls] = assembled.walls[first]
    return renamed[numbers.wall_of]


def wall_extents(assembled: Assembled) -> tuple[Floats, Floats]:
    """Return the extent of each wall along itself, from its centre: right and left; (w,)."""
    from relmap.core.linalg.order_kernels import quantiles

    given, state = assembled.given, assembled.state
    along = directions(state.angle)[1][given.wall]
    off = placed_ends(assembled) - state.centre[given.wall][:, None]
    reach = np.einsum("nei,ni->ne", off, along)
    return (
        quantiles(given.wall, reach[:, 0].copy(), OUTLYING),
        -quantiles(given.wall, -reach[:, 1], OUTLYING),
    )


def _pairs(assembled: Assembled, low: Floats, high: Floats) -> Ints:
    """Return pairs (k, 2) of walls that coincide."""
    state = assembled.state
    normal, along = directions(state.angle)
    base = state.centre + state.across[:, None] * normal
    a, b = _near(base + (low + high)[:, None] / 2 * along, (high - low) / 2, normal)
    offset = base[b] - base[a]
    shift = (offset * along[a]).sum(axis=1)
    begin = np.maximum(low[a], low[b] + shift)
    end = np.minimum(high[a], high[b] + shift)
    shorter = np.minimum(high[a] - low[a], high[b] - low[b])
    middle = (begin + end) / 2
    tilt = (along[b] * normal[a]).sum(axis=1)
    across = (offset * normal[a]).sum(axis=1) + (middle - shift) * tilt
    if not len(a):
        return np.empty((0, 2), dtype=np.int64)  # not supported by scipy's sparse arrays
    both = np.asarray(seen_together(assembled)[a, b] > 0).reshape(-1)
    limit = np.where(both, BESIDE_M, ACROSS_M)
    on_one_another = (end - begin >= OVERLAP * shorter) & (np.abs(across) <= limit)
    return np.column_stack([a[on_one_another], b[on_one_another]])


def _near(middle: Floats, half: Floats, normal: Floats) -> tuple[Ints, Ints]:
    """Return pairs a < b of walls (w,) that face the same way and may touch, by their midpoints."""
    a, b = [], []
    for begin in range(0, len(half), BLOCK):
        rows = slice(begin, begin + BLOCK)
        near = normal[rows] @ normal[begin:].T > np.cos(TURN_RAD)
        for axis in middle.T:
            reach = half[rows, None] + half[begin:] + ACROSS_M
            near &= np.abs(axis[rows, None] - axis[begin:]) <= reach
        row, other = np.nonzero(near)
        a.append(begin + row[row < other])
        b.append(begin + other[row < other])
    return np.concatenate(a), np.concatenate(b)


def seen_in(assembled: Assembled) -> Any:
    """Return how often each wall was seen in each scan; a sparse array (w, i)."""
    given = assembled.given
    shape = len(assembled.walls), len(assembled.iterations)
    return coo_array((np.ones(len(given.wall)), (given.wall, given.iteration)), shape).tocsr()


def seen_together(assembled: Assembled) -> Any:
    """Return in how many scans each pair of walls was seen together; a sparse array (w, w)."""
    seen = seen_in(assembled)
    return (seen @ seen.T).tocsr()


def joined_corners(assembled: Assembled, corner_of: Ints, wall_of: Ints) -> Ints:
    """Return the corner (c,) of every corner number after walls are joined; -1 if it is none.

    `corner_of` (c,): the same before; `wall_of` (w,): the wall that each became part of.
    """
    given, corners = assembled.given, assembled.corners
    if not len(corners):
        return corner_of
    count = np.bincount(given.corner, minlength=len(corners))
    end = np.zeros(len(corners), dtype=np.int64)
    end[given.corner] = given.corner_end
    wall = wall_of[assembled.corner_wall]
    place = (assembled.corner_at * directions(assembled.state.angle[wall])[1]).sum(axis=1)
    order = np.lexsort((-count, 2 * wall + end))
    same = np.arange(len(corners))
    for rows in np.split(order, np.flatnonzero(np.diff((2 * wall + end)[order])) + 1):
        taken: list[int] = []
        for row in rows.tolist():
            near = [other for other in taken if abs(place[other] - place[row]) < CORNER_M]
            if near:
                same[row] = near[0]
            else:
                taken.append(row)
    beyond = _times_seen_beyond(assembled, wall_of, wall, place)
    every = np.arange(len(corner_of))
    every[corners] = np.where((beyond > count)[same], -1, corners[same])
    return np.where(corner_of < 0, -1, every[corner_of])


def _times_seen_beyond(assembled: Assembled, wall_of: Ints, wall: Ints, place: Floats) -> Ints:
    """Count how often the walls (c,) of corners were seen beyond the corners' positions (c,)."""
    own = wall_of[assembled.given.wall]
    along = directions(assembled.state.angle[own])[1]
    reach = np.einsum("nei,ni->ne", placed_ends(assembled), along)
    # Corners sorted by wall and position: each observation spans a consecutive range of them.
    apart_m = 2 * float(max(np.abs(reach).max(), np.abs(place).max())) + 1.0
    key = wall * apart_m + place
    order = np.argsort(key, kind="stable")
    right, left = (reach + [BEYOND_M, -BEYOND_M] + (own * apart_m)[:, None]).T
    begin = np.searchsorted(key[order], right, side="right")
    end = np.maximum(np.searchsorted(key[order], left), begin)
    n = len(key) + 1
    times = np.cumsum(np.bincount(begin, minlength=n) - np.bincount(end, minlength=n))[:-1]
    found = np.empty_like(times)
    found[order] = times
    return found


def placed_ends(assembled: Assembled) -> Floats:
    """Return the ends (n, 2, 2) of the observations in the map frame."""
    given, state = assembled.given, assembled.state
    c, s = np.cos(state.yaw), np.sin(state.yaw)
    return placed(given.ends, c[given.iteration], s[given.iteration], state.t[given.iteration])
