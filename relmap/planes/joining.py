"""Walls seen again: tracks that lie on one another, once the map is refined, are one wall.

Corners tell who is who where the map has drifted (`merging`).  Where it has not, so do lines: two
tracks with one normal and one offset that overlap along the wall show the same wall, corner or not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from relmap.planes.assembly import Assembled, WallNumbers, directions
from relmap.planes.refinement import quantiles

TURN_RAD = np.deg2rad(6.0)
ACROSS_M = 0.15
BESIDE_M = 0.05
"""The same for two that were seen side by side in one scan."""
OVERLAP = 0.3
"""Share of the shorter one that must lie on the longer one."""
CORNER_M = 0.35
"""How far two corners at one end of a wall may be apart."""
BEYOND_M = 0.3
"""A wall seen so far beyond a corner, more often than not, has no corner there."""
OUTLYING = 0.05
"""Share of the sights of a wall that go farther than it does."""


def join_walls(assembled: Assembled, numbers: WallNumbers) -> WallNumbers:
    """Return who is who, with tracks on one line joined, and false corners left out (-1)."""
    low, high = wall_extents(assembled)
    first = _first_of(len(assembled.walls), _pairs(assembled, low, high))
    corner_of = _joined_corners(assembled, first)
    return WallNumbers(
        _renamed(assembled, numbers, first),
        np.where(numbers.corner_of < 0, -1, corner_of[numbers.corner_of]),
    )


def join_pairs(assembled: Assembled, numbers: WallNumbers, pairs: NDArray[np.int64]) -> WallNumbers:
    """Return who is who when pairs (k, 2) of compact wall numbers are one wall each."""
    first = _first_of(len(assembled.walls), pairs)
    return WallNumbers(_renamed(assembled, numbers, first), numbers.corner_of)


def _first_of(n: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each of n walls the first of those that pairs join it to."""
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    n_parts, part = connected_components(graph, directed=False)
    first = np.full(n_parts, n)
    np.minimum.at(first, part, np.arange(n))
    return first[part]


def _renamed(
    assembled: Assembled, numbers: WallNumbers, first: NDArray[np.int64]
) -> NDArray[np.int64]:
    renamed = np.arange(len(numbers.wall_of))
    renamed[assembled.walls] = assembled.walls[first]
    return renamed[numbers.wall_of]


def wall_extents(assembled: Assembled) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far each wall was seen along itself, from its centre: right and left; (w,)."""
    given, state = assembled.given, assembled.state
    along = directions(state.angle)[1][given.wall]
    c, s = np.cos(state.yaw[given.iteration]), np.sin(state.yaw[given.iteration])
    R = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    placed = np.einsum("nij,nej->nei", R, given.ends) + state.t[given.iteration][:, None]
    reach = np.einsum("nei,ni->ne", placed - state.centre[given.wall][:, None], along)
    return (
        quantiles(given.wall, reach[:, 0], OUTLYING),
        -quantiles(given.wall, -reach[:, 1], OUTLYING),
    )


def _pairs(
    assembled: Assembled, low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return pairs (k, 2) of walls that lie on one another."""
    state = assembled.state
    normal, along = directions(state.angle)
    a, b = np.triu_indices(len(state.angle), k=1)
    near = normal[a, 0] * normal[b, 0] + normal[a, 1] * normal[b, 1] > np.cos(TURN_RAD)
    a, b = a[near], b[near]
    base = state.centre + state.across[:, None] * normal
    offset = base[b] - base[a]
    shift = (offset * along[a]).sum(axis=1)
    begin = np.maximum(low[a], low[b] + shift)
    end = np.minimum(high[a], high[b] + shift)
    shorter = np.minimum(high[a] - low[a], high[b] - low[b])
    middle = (begin + end) / 2
    tilt = (along[b] * normal[a]).sum(axis=1)
    across = (offset * normal[a]).sum(axis=1) + (middle - shift) * tilt
    if not len(a):
        return np.empty((0, 2), dtype=np.int64)  # scipy's sparse arrays index nothing badly
    both = _seen_together(assembled, a, b)
    limit = np.where(both, BESIDE_M, ACROSS_M)
    on_one_another = (end - begin >= OVERLAP * shorter) & (np.abs(across) <= limit)
    return np.column_stack([a[on_one_another], b[on_one_another]])


def _seen_together(
    assembled: Assembled, a: NDArray[np.int64], b: NDArray[np.int64]
) -> NDArray[np.bool_]:
    given = assembled.given
    n = len(assembled.walls)
    seen = coo_array(
        (np.ones(len(given.wall)), (given.wall, given.iteration)),
        shape=(n, len(assembled.iterations)),
    ).tocsr()
    together = (seen @ seen.T).tocsr()
    return np.asarray(together[a, b] > 0).reshape(-1)


def _joined_corners(assembled: Assembled, wall_of: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for every corner ever numbered which one it is; -1 where it is none."""
    given, at = assembled.given, assembled.corner_at
    n = int(assembled.corners.max(initial=-1)) + 1
    result = np.arange(max(n, 1 + int(assembled.all_corners.max(initial=-1))))
    count = np.bincount(given.corner, minlength=len(assembled.corners))
    end = np.zeros(len(assembled.corners), dtype=np.int64)
    end[given.corner] = given.corner_end
    wall = wall_of[assembled.corner_wall]
    along = directions(assembled.state.angle)[1]
    for key in np.unique(2 * wall + end):
        rows = np.flatnonzero(2 * wall + end == key)
        rows = rows[np.argsort(-count[rows], kind="stable")]
        place = at[rows] @ along[key // 2]
        taken: list[int] = []
        for k, row in enumerate(rows.tolist()):
            same = [j for j in taken if abs(place[j] - place[k]) < CORNER_M]
            if same:
                result[assembled.corners[row]] = assembled.corners[rows[same[0]]]
            else:
                taken.append(k)
        for j in taken:
            if _seen_beyond(assembled, wall_of, int(key), at[rows[j]], int(count[rows[j]])):
                joined = result[assembled.corners[rows]] == assembled.corners[rows[j]]
                result[assembled.corners[rows[joined]]] = -1
    return result


def _seen_beyond(
    assembled: Assembled, wall_of: NDArray[np.int64], key: int, at: NDArray[np.float64], n: int
) -> bool:
    """Tell whether a wall goes on beyond what was taken for a corner of its."""
    given, state = assembled.given, assembled.state
    rows = np.flatnonzero(wall_of[given.wall] == key // 2)
    along = directions(state.angle[[key // 2]])[1][0]
    yaw, t = state.yaw[given.iteration[rows]], state.t[given.iteration[rows]]
    ends = given.ends[rows]
    x = np.cos(yaw)[:, None] * ends[..., 0] - np.sin(yaw)[:, None] * ends[..., 1] + t[:, :1]
    y = np.sin(yaw)[:, None] * ends[..., 0] + np.cos(yaw)[:, None] * ends[..., 1] + t[:, 1:]
    reach = (x - at[0]) * along[0] + (y - at[1]) * along[1]
    if key % 2:
        reach = -reach[:, ::-1]
    across_it = (reach[:, 0] < -BEYOND_M) & (reach[:, 1] > BEYOND_M)
    return bool(across_it.sum() > n)
