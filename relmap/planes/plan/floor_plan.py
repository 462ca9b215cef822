"""The floor plan: existing walls of a submap, without duplicates and at full length.

A wall is drawn where scans saw it and beams ended on it instead of passing through; the poses are
used for this test only, not to place walls. Of two adjacent walls that face the same way, the one
observed more often is kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Bools, Ints
from relmap.planes.plan.evidence import BIN_M, Stretches, stretches_of
from relmap.planes.plan.pieces import SHORTEST_M, Pieces, met, with_corners
from relmap.planes.plan.regrouping import regrouped
from relmap.planes.scans.beam_store import BeamStore
from relmap.planes.submaps.submap import WallSubmap
from relmap.planes.walls.assembly import OFTEN, Assembled, WallNumbers, directions
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.joining import placed_ends

SEEN = 3
"""Observations of a stretch of wall required to draw it; one stretch needs as many as a wall."""
AGAINST = 0.7
"""Largest ratio of beams against a wall to beams that end on it."""
SOLID = 0.7
"""Smallest fraction of the beams towards a wall that must end on it."""
GAP_M = 0.5
"""A gap longer than this is kept even if no beam passed through."""
DOUBLED_M, PARALLEL = 0.12, np.cos(np.deg2rad(12.0))
"""Distance and rotation (cosine) up to which a wall is a duplicate of another."""


def floor_plan(
    submap: WallSubmap, numbers: WallNumbers, history: PlaneHistory, beams: BeamStore, moving: Bools
) -> tuple[WallSubmap, WallNumbers, Ints]:
    """Return a submap with only the walls of its floor plan; one without walls unchanged.

    `numbers`: its association; `beams`: if empty, only the observed walls are used; `moving` (p,):
    plane tracks that move. Returns `moved` (m,): tracks found to have moved.
    """
    if submap.assembled is None:
        return submap, numbers, np.empty(0, dtype=np.int64)
    walls, numbers, moved = regrouped(submap, numbers, history, moving)
    stretches = stretches_of(walls, submap.poses, submap.span, beams)
    pieces = with_corners(_pieces(stretches, _standing(stretches)), walls)
    drawn, numbers = drawn_walls(walls, met(pieces, stretches), numbers, history)
    return WallSubmap.of(submap.span, submap.poses, drawn, submap.refined), numbers, moved


def _standing(walls: Stretches) -> Bools:
    """Return where walls exist (b,): seen, not seen through, and no duplicate of a stronger one."""
    hits, against = _around(walls.hits, 1), _around(walls.against, 1)
    no_wall = (against > AGAINST * hits) & (against > 1)
    there = (walls.seen >= SEEN) & ~no_wall
    if walls.hits.any():
        there &= _around(walls.hits, 2) > 0
    doubled = _doubled(walls, there)
    there &= ~doubled
    return there | _small_gaps(walls, there, no_wall | doubled)


def _around(counts: Ints, beside: int) -> Ints:
    """Return counts summed over neighbouring stretches; margins separate the walls."""
    return np.asarray(np.convolve(counts, np.ones(2 * beside + 1, dtype=np.int64), "same"))


def _doubled(walls: Stretches, there: Bools) -> Bools:
    """Return where a wall (b,) duplicates a wall that faces the same way and was seen more."""
    wall, half = walls.wall, BIN_M * np.diff(walls.first) / 2
    points = walls.base[wall] + walls.place[:, None] * walls.along[wall]
    middle = walls.base + (walls.low + half)[:, None] * walls.along
    seen = np.bincount(wall, np.where(there, walls.seen, 0), minlength=len(half))
    beside_m = DOUBLED_M + half * np.sqrt(1 - PARALLEL**2)
    doubled, order = np.zeros(len(wall), dtype=np.bool_), np.argsort(-seen, kind="stable")
    for rank, k in enumerate(order.tolist()):
        others, own = order[:rank], slice(walls.first[k], walls.first[k + 1])
        offset = middle[others] - middle[k]
        near = np.abs(offset @ walls.along[k]) < half[others] + half[k]
        near &= np.abs(offset @ walls.normal[k]) < beside_m[others]
        near &= walls.normal[others] @ walls.normal[k] > PARALLEL
        for other in others[near].tolist():
            off = points[own] - walls.base[other]
            at = ((off @ walls.along[other] - walls.low[other]) / BIN_M).astype(np.int64)
            at = walls.first[other] + np.clip(at, 0, np.diff(walls.first)[other] - 1)
            beside = np.abs(off @ walls.normal[other]) < DOUBLED_M
            doubled[own] |= there[at] & ~doubled[at] & beside
    return doubled


def _small_gaps(walls: Stretches, there: Bools, known: Bools) -> Bools:
    """Return which stretches (b,) are gaps in a wall without evidence of an opening."""
    begin, end = _runs(~there & ~known)
    inside = (begin > 0) & (end < len(there)) & (BIN_M * (end - begin) <= GAP_M)
    begin, end = begin[inside], end[inside]
    inside = there[begin - 1] & there[end] & (walls.wall[begin - 1] == walls.wall[end])
    change = np.zeros(len(there) + 1, dtype=np.int64)
    change[begin[inside]] = 1
    change[end[inside]] = -1
    return np.asarray(np.cumsum(change)[:-1] > 0)


def _runs(mask: Bools) -> tuple[Ints, Ints]:
    """Return start and end of each run of True."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return edges[::2], edges[1::2]


def _pieces(walls: Stretches, there: Bools) -> Pieces:
    """Return the existing parts of walls, without marginal ones."""
    begin, end = _runs(there)
    sums = [np.append(0, np.cumsum(counts)) for counts in (walls.hits, walls.against)]
    hits, against = (total[end] - total[begin] for total in sums)
    bounds = np.column_stack([begin, end]).ravel()
    most = np.maximum.reduceat(np.append(walls.seen, 0), bounds)[::2] if len(begin) else begin
    kept = (hits >= SOLID * (hits + against)) & (most >= OFTEN)
    kept &= BIN_M * (end - begin) >= SHORTEST_M
    begin, end = begin[kept], end[kept]
    low = walls.place[begin] - BIN_M / 2
    reach = np.column_stack([low, low + BIN_M * (end - begin)])
    return Pieces(walls.wall[begin], reach, np.full((len(begin), 2), -1))


def drawn_walls(
    walls: Assembled, pieces: Pieces, numbers: WallNumbers, history: PlaneHistory
) -> tuple[Assembled, WallNumbers]:
    """Return one wall for each piece, from the tracks that lie on it, and the association.

    Tracks that lie on no piece become separate, unmapped walls.
    """
    track = history.plane[walls.rows]
    tracks = np.unique(track)
    own, on = _lying_on(walls, pieces, track)
    piece = np.full(len(numbers.wall_of), -1)
    piece[own] = on  # the one with the largest part is last
    placed = tracks[piece[tracks] >= 0]
    drawn, first, of = np.unique(piece[placed], return_index=True, return_inverse=True)
    wall_of = numbers.wall_of.copy()
    wall_of[tracks] = tracks
    wall_of[placed] = placed[first[of]]
    order = np.argsort(first)  # walls are identified by their lowest track number
    rank = np.full(len(pieces) + 1, -1)
    rank[drawn[order]] = np.arange(len(order))
    found = _of_pieces(walls, pieces.only(drawn[order]), rank[piece[track]], placed[first[order]])
    return found, WallNumbers(wall_of, numbers.corner_of)


def _lying_on(walls: Assembled, pieces: Pieces, track: Ints) -> tuple[Ints, Ints]:
    """Return tracks (k,) and the pieces (k,) they lie on, by ascending overlap."""
    state, of = walls.state, walls.given.wall
    normal, along = directions(state.angle)
    base = state.centre + state.across[:, None] * normal
    seen = np.einsum("nei,ni->ne", placed_ends(walls) - base[of][:, None], along[of])
    order = np.argsort(pieces.wall, kind="stable")
    begin, end = np.searchsorted(pieces.wall[order], [of, of + 1])
    n = end - begin
    row = np.repeat(np.arange(len(of)), n)
    piece = order[np.arange(len(row)) - (np.cumsum(n) - n)[row] + begin[row]]
    low = np.maximum(seen[row, 0], pieces.reach[piece, 0])
    overlap = np.minimum(seen[row, 1], pieces.reach[piece, 1]) - low
    key, at = np.unique(track[row] * len(pieces) + piece, return_inverse=True)
    total = np.bincount(at, np.maximum(overlap, 0.0), minlength=len(key))
    order = np.argsort(total, kind="stable")
    key = key[order[total[order] > 0]]
    return key // max(len(pieces), 1), key % max(len(pieces), 1)


def _of_pieces(walls: Assembled, pieces: Pieces, of: Ints, numbers: Ints) -> Assembled:
    """Return the walls of pieces, with these numbers, and the piece of each row (n,)."""
    given, state, wall = walls.given, walls.state, pieces.wall
    ends_piece = np.full(len(walls.corners), -1)
    row, end = np.nonzero(pieces.corner >= 0)
    ends_piece[pieces.corner[row, end]] = row
    row_piece = of[given.corner_row]
    at_end = (row_piece >= 0) & (ends_piece[given.corner] == row_piece)
    equations = replace(
        given,
        wall=of,
        corner_row=given.corner_row[at_end],
        corner_end=given.corner_end[at_end],
        corner=given.corner[at_end],
        corner_sd=given.corner_sd[at_end],
        missed_m=given.missed_m[at_end],
    )
    lines = replace(
        state, centre=state.centre[wall], angle=state.angle[wall], across=state.across[wall]
    )
    every = replace(walls, given=equations, state=lines, walls=numbers, reach=pieces.reach)
    return every.only(of >= 0)
