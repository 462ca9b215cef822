"""The floor plan: the refined walls that are there, each of them once and as long as it is.

A wall is drawn where scans saw it and no more beams went against than ended on it; the poses serve
to judge that, not to place anything.  Where two walls look the same way side by side, the one that
was seen more stands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from relmap.planes.assembly import Assembled, WallNumbers, directions
from relmap.planes.beams import Beams
from relmap.planes.history import PlaneHistory
from relmap.planes.joining import CORNER_M, placed_ends
from relmap.planes.plan_evidence import BIN_M, Stretches, stretches_of
from relmap.planes.regrouping import regrouped
from relmap.planes.submaps import WallSubmap

SEEN = 3
"""Sights of a stretch of a wall that is there."""
OFTEN = 4
"""Sights of the stretch of a wall that was seen most."""
SEEN_THROUGH = 0.7
SOLID = 0.7
"""Share of the beams that reach a wall which end on it, at least."""
GAP_M = 0.5
"""A gap longer than this is one, though no beam went against."""
SHORTEST_M = 0.12
DOUBLED_M = 0.12
PARALLEL = np.cos(np.deg2rad(12.0))
MEETING_M = 0.25
"""A wall that ends so near another one ends there."""
ALONE_M, IN_PART_M = 0.5, 0.25
"""Walls shorter than this that meet no longer one are clutter: with both ends seen, or in part."""


@dataclass(eq=False)
class Pieces:
    """Parts of walls, as they are drawn; n of them.

    Attributes
    ----------
    wall : (n,) int64
        Compact number of the wall.
    reach : (n, 2) float64, metres
        From where to where, along the wall.
    corner : (n, 2) int64
        Compact number of the corner at either end; -1 where there is none.
    """

    wall: NDArray[np.int64]
    reach: NDArray[np.float64]
    corner: NDArray[np.int64]

    def only(self, kept: NDArray[np.bool_]) -> Pieces:
        """Return some of them."""
        return Pieces(self.wall[kept], self.reach[kept], self.corner[kept])


def floor_plan(
    submap: WallSubmap,
    numbers: WallNumbers,
    history: PlaneHistory,
    beams: Beams,
    moving: NDArray[np.bool_],
) -> tuple[WallSubmap, WallNumbers, NDArray[np.int64]]:
    """Return a submap with the walls of its floor plan alone.

    Parameters
    ----------
    submap : WallSubmap
    numbers : WallNumbers
        Who is who in it.
    history : PlaneHistory
    beams : Beams
    moving : (p,) bool
        Plane tracks that move.

    Returns
    -------
    submap : WallSubmap
    numbers : WallNumbers
    moved : (m,) int64
        Tracks that turned out to have moved.
    """
    if submap.assembled is None or not submap.refined:
        return submap, numbers, np.empty(0, dtype=np.int64)
    walls, numbers, moved = regrouped(submap, numbers, history, moving)
    stretches = stretches_of(walls, submap.poses, submap.span, beams)
    pieces = _with_corners(_pieces(stretches, _standing(stretches)), walls)
    pieces = _without_clutter(_met(pieces, stretches), stretches)
    drawn, numbers = _drawn(walls, pieces, numbers, history)
    return WallSubmap.of(submap.span, submap.poses, drawn, submap.refined), numbers, moved


def _standing(walls: Stretches) -> NDArray[np.bool_]:
    """Tell where walls are (b,): seen, not seen against, and not the double of a stronger one."""
    hits, against = _around(walls.hits, 1), _around(walls.against, 1)
    open_ = (against > SEEN_THROUGH * hits) & (against > 1)
    there = (walls.seen >= SEEN) & ~open_
    if walls.hits.any():
        there &= _around(walls.hits, 2) > 0
    doubled = _doubled(walls, there)
    there &= ~doubled
    return there | _small_gaps(there, open_ | doubled, walls)


def _around(counts: NDArray[np.int64], beside: int) -> NDArray[np.int64]:
    """Return counts with those of some stretches on either side; rims keep walls apart."""
    return np.asarray(np.convolve(counts, np.ones(2 * beside + 1, dtype=np.int64), "same"))


def _doubled(walls: Stretches, there: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell where a wall (b,) lies beside another that looks the same way and was seen more."""
    wall, place = walls.wall, walls.place
    points = walls.base[wall] + place[:, None] * walls.along[wall]
    seen = np.bincount(wall, np.where(there, walls.seen, 0), minlength=len(walls.low))
    doubled = np.zeros(len(wall), dtype=np.bool_)
    low = walls.low + BIN_M * (np.diff(walls.first) / 2)
    middle = walls.base + low[:, None] * walls.along
    half = BIN_M * np.diff(walls.first) / 2
    for k in np.argsort(-seen, kind="stable").tolist():
        own = slice(walls.first[k], walls.first[k + 1])
        offset = middle - middle[k]
        beside = np.abs(offset @ walls.normal[k]) < DOUBLED_M + half * np.sqrt(1 - PARALLEL**2) + half[k]*0
        near = np.abs(offset @ walls.along[k]) < half + half[k]
        others = beside & near & (walls.normal @ walls.normal[k] > PARALLEL)
        others &= (seen > seen[k]) | ((seen == seen[k]) & (np.arange(len(seen)) < k))
        for other in np.flatnonzero(others).tolist():
            off = points[own] - walls.base[other]
            at = ((off @ walls.along[other] - walls.low[other]) / BIN_M).astype(np.int64)
            first, n = walls.first[other], walls.first[other + 1] - walls.first[other]
            at = np.clip(at, 0, n - 1) + first
            covers = there[at] & ~doubled[at]
            doubled[own] |= covers & (np.abs(off @ walls.normal[other]) < DOUBLED_M)
    return doubled


def _small_gaps(
    there: NDArray[np.bool_], open_: NDArray[np.bool_], walls: Stretches
) -> NDArray[np.bool_]:
    """Tell which stretches (b,) are gaps that nothing is known of, within a wall."""
    begin, end = _runs(~there & ~open_)
    wall = walls.wall
    inside = (begin > 0) & (end < len(there)) & (BIN_M * (end - begin) <= GAP_M)
    begin, end = begin[inside], end[inside]
    inside = there[begin - 1] & there[end] & (wall[begin - 1] == wall[end])
    gap = np.zeros(len(there) + 1, dtype=np.int64)
    gap[begin[inside]] += 1
    gap[end[inside]] -= 1
    return np.asarray(np.cumsum(gap)[:-1] > 0)


def _runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where runs of True begin and where they end."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return edges[::2], edges[1::2]


def _pieces(walls: Stretches, there: NDArray[np.bool_]) -> Pieces:
    """Return the parts of walls that are there, without those that are hardly so."""
    wall = walls.wall
    edge = walls.first[1:-1]
    there = there.copy()
    there[edge] = False
    begin, end = _runs(there)
    hits, against, seen = (
        np.concatenate([[0], np.cumsum(each)]) for each in (walls.hits, walls.against, walls.seen)
    )
    h, t = hits[end] - hits[begin], against[end] - against[begin]
    most = np.maximum.reduceat(np.append(walls.seen, 0), np.column_stack([begin, end]).ravel())[::2]
    kept = (h >= SOLID * (h + t)) & (most >= OFTEN) & (BIN_M * (end - begin) >= SHORTEST_M)
    begin, end = begin[kept], end[kept]
    low = walls.place[begin] - BIN_M / 2
    reach = np.column_stack([low, low + BIN_M * (end - begin)])
    return Pieces(wall[begin], reach, np.full((len(begin), 2), -1))


def _with_corners(pieces: Pieces, walls: Assembled) -> Pieces:
    """Return pieces that end at the corners of their walls; a corner within one parts it."""
    given = walls.given
    count = np.bincount(given.corner, minlength=len(walls.corners))
    side = np.zeros(len(walls.corners), dtype=np.int64)
    side[given.corner] = given.corner_end
    wall, place = walls.corner_wall.tolist(), walls.state.along.tolist()
    drawn: dict[int, list[list[Any]]] = {}
    for k, (low, high) in zip(pieces.wall.tolist(), pieces.reach.tolist(), strict=True):
        drawn.setdefault(k, []).append([low, high, -1, -1])
    for k in np.argsort(-count, kind="stable").tolist():  # what was seen most often is first
        parts, end = drawn.get(wall[k], []), int(side[k])
        free = [part for part in parts if part[2 + end] < 0]
        near = [part for part in free if abs(part[end] - place[k]) <= CORNER_M]
        near = [part for part in near if (part[1 - end] - place[k]) * (1 - 2 * end) > SHORTEST_M]
        if near:
            part = min(near, key=lambda part: abs(part[end] - place[k]))
            part[end], part[2 + end] = place[k], k
            continue
        for part in [part for part in free if part[0] < place[k] < part[1]]:
            rest = part.copy()
            rest[1 - end], rest[3 - end] = place[k], -1
            part[end], part[2 + end] = place[k], k
            parts.append(rest)
    rows = [(k, part) for k in sorted(drawn) for part in sorted(drawn[k])]
    found = np.array([part for _, part in rows]).reshape(-1, 4)
    return Pieces(np.array([k for k, _ in rows], dtype=np.int64), found[:, :2], found[:, 2:].astype(np.int64))


def _met(pieces: Pieces, walls: Stretches) -> Pieces:
    """Return pieces that end where they meet others, neither beyond nor short of them."""
    base, along, normal = (each[pieces.wall] for each in (walls.base, walls.along, walls.normal))
    reach = pieces.reach.copy()
    cross = along @ normal.T  # (n, n): along of row with normal of column
    offset = base[None] - base[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.einsum("ijk,jk->ij", offset, normal) / cross
    at = base[:, None] + place[:, :, None] * along[:, None]
    other = np.einsum("ijk,jk->ij", at - base[None], along)
    rim = MEETING_M
    on = (other > reach[None, :, 0] - rim) & (other < reach[None, :, 1] + rim)
    on &= np.abs(cross) > np.sin(np.deg2rad(30.0))
    for end in (0, 1):
        off = np.where(on, np.abs(place - reach[:, end, None]), np.inf)
        nearest = off.argmin(axis=1)
        row = np.flatnonzero((off.min(axis=1) < MEETING_M) & (pieces.corner[:, end] < 0))
        reach[row, end] = place[row, nearest[row]]
    good = reach[:, 1] - reach[:, 0] > SHORTEST_M / 2
    return Pieces(pieces.wall, reach, pieces.corner).only(good)


def _without_clutter(pieces: Pieces, walls: Stretches) -> Pieces:
    """Return pieces without the short ones that hang together with no longer one."""
    base, along = walls.base[pieces.wall], walls.along[pieces.wall]
    ends = (base[:, None] + pieces.reach[:, :, None] * along[:, None]).reshape(-1, 2)
    near = cKDTree(ends).query_pairs(MEETING_M, output_type="ndarray") // 2
    n = len(pieces.wall)
    graph = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(n, n))
    n_parts, part = connected_components(graph, directed=False)
    length = pieces.reach[:, 1] - pieces.reach[:, 0]
    whole = (pieces.corner >= 0).all(axis=1)
    alone = np.ones(n_parts, dtype=np.bool_)
    alone[part[length >= np.where(whole, ALONE_M, IN_PART_M)]] = False
    return pieces.only(~alone[part])


def _drawn(
    walls: Assembled, pieces: Pieces, numbers: WallNumbers, history: PlaneHistory
) -> tuple[Assembled, WallNumbers]:
    """Return the walls with one for each piece, of the tracks that lie there."""
    piece_of = _pieces_of_tracks(walls, pieces, history.plane[walls.rows], len(numbers.wall_of))
    tracks = np.unique(history.plane[walls.rows])
    placed = tracks[piece_of[tracks] >= 0]
    drawn, first, of = np.unique(piece_of[placed], return_index=True, return_inverse=True)
    wall_of = numbers.wall_of.copy()
    wall_of[tracks] = tracks
    wall_of[placed] = placed[first[of]]
    order = drawn[np.argsort(placed[first])]
    rank = np.full(len(pieces.wall) + 1, -1)
    rank[order] = np.arange(len(order))
    row_piece = rank[piece_of[history.plane[walls.rows]]]
    kept = Pieces(pieces.wall[order], pieces.reach[order], pieces.corner[order])
    found = WallNumbers(wall_of, numbers.corner_of)
    return _of_pieces(walls, kept, row_piece, np.sort(placed[first])), found


def _pieces_of_tracks(
    walls: Assembled, pieces: Pieces, track: NDArray[np.int64], n_tracks: int
) -> NDArray[np.int64]:
    """Return the piece that most of each track (p,) lies on; -1 where it lies on none."""
    given, state = walls.given, walls.state
    normal, along = directions(state.angle)
    base = state.centre + state.across[:, None] * normal
    of = given.wall
    seen = np.einsum("nei,ni->ne", placed_ends(walls) - base[of][:, None], along[of])
    order = np.argsort(pieces.wall, kind="stable")
    begin, end = np.searchsorted(pieces.wall[order], [of, of + 1])
    n = end - begin
    row = np.repeat(np.arange(len(of)), n)
    piece = order[np.arange(len(row)) - (np.cumsum(n) - n)[row] + begin[row]]
    low = np.maximum(seen[row, 0], pieces.reach[piece, 0])
    overlap = np.minimum(seen[row, 1], pieces.reach[piece, 1]) - low
    key, at = np.unique(track[row] * len(pieces.wall) + piece, return_inverse=True)
    total = np.bincount(at, np.maximum(overlap, 0.0), minlength=len(key))
    found = np.full(n_tracks, -1)
    rows = np.argsort(total, kind="stable")
    rows = rows[total[rows] > 0]
    tracks, on = key[rows] // len(pieces.wall), key[rows] % len(pieces.wall)
    found[tracks] = on  # the longest is last
    # A piece that has none takes one from a piece that has several.
    times = np.bincount(found[np.unique(tracks)], minlength=len(pieces.wall))
    for each, k in zip(tracks[::-1].tolist(), on[::-1].tolist(), strict=True):
        if times[k] == 0 and times[found[each]] > 1:
            times[found[each]] -= 1
            times[k], found[each] = 1, k
    return found


def _of_pieces(
    walls: Assembled, pieces: Pieces, of: NDArray[np.int64], numbers: NDArray[np.int64]
) -> Assembled:
    """Return the walls that pieces are, with these numbers, and the piece of each row (n,)."""
    given, state = walls.given, walls.state
    corner = np.full(len(walls.corners), -1)
    row, end = np.nonzero(pieces.corner >= 0)
    corner[pieces.corner[row, end]] = row
    at_end = (of[given.corner_row] >= 0) & (corner[given.corner] == of[given.corner_row])
    equations = replace(
        given,
        wall=of,
        corner_row=given.corner_row[at_end],
        corner_end=given.corner_end[at_end],
        corner=given.corner[at_end],
        corner_sd=given.corner_sd[at_end],
    )
    wall = pieces.wall
    of_piece = replace(
        state, centre=state.centre[wall], angle=state.angle[wall], across=state.across[wall]
    )
    every = replace(walls, given=equations, state=of_piece, walls=numbers, reach=pieces.reach)
    return every.only(of >= 0)
