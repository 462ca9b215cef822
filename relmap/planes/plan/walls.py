"""From the pieces of a floor plan to walls, with their tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Ints
from relmap.planes.plan.pieces import Pieces
from relmap.planes.walls.assembly import Assembled, WallNumbers, directions
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.joining import placed_ends


def drawn_walls(
    walls: Assembled, pieces: Pieces, numbers: WallNumbers, history: PlaneHistory
) -> tuple[Assembled, WallNumbers]:
    """Return one wall for each piece, from the tracks that lie on it, and the association.

    Tracks that lie on no piece become separate, unmapped walls.
    """
    track = history.plane[walls.rows]
    tracks = np.unique(track)
    piece = _piece_of_tracks(walls, pieces, track, len(numbers.wall_of))
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


def _piece_of_tracks(walls: Assembled, pieces: Pieces, track: Ints, n_tracks: int) -> Ints:
    """Return the piece that most of each track (p,) lies on; -1 for none.

    A piece without tracks takes one from a piece that has several.
    """
    tracks, on = _lying_on(walls, pieces, track)
    found = np.full(n_tracks, -1)
    found[tracks] = on  # the one with the largest part is last
    times = np.bincount(found[np.unique(tracks)], minlength=len(pieces))
    for each, k in zip(tracks[::-1].tolist(), on[::-1].tolist(), strict=True):
        if times[k] == 0 and times[found[each]] > 1:
            times[found[each]] -= 1
            times[k], found[each] = 1, k
    return found


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
    )
    lines = replace(
        state, centre=state.centre[wall], angle=state.angle[wall], across=state.across[wall]
    )
    every = replace(walls, given=equations, state=lines, walls=numbers, reach=pieces.reach)
    return every.only(of >= 0)
