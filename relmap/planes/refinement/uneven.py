"""Long walls that are not straight, as several that are nearly in line and were joined: in pieces.

As one line, such a wall would bend the path.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Ints
from relmap.planes.walls.assembly import FLAT_M, OFTEN, Assembled, directions, laid_out
from relmap.planes.walls.history import PlaneHistory
from relmap.planes.walls.joining import placed_ends

PIECE_M = 20.0
"""Length of the pieces of a wall."""
UNEVEN, UNEVEN_M = 5.0, 0.05
"""Deviation of observations from a wall above which it is not straight: in standard deviations, and
at least."""


def in_pieces(assembled: Assembled, history: PlaneHistory) -> Assembled | None:
    """Return the equations with long uneven walls in pieces, each a wall with its own corners.

    The standard deviations of observations are those of pieces, as they were first. Returns None
    if there is no such wall.
    """
    given, state = assembled.given, assembled.state
    sd = np.hypot(history.sd[assembled.rows], FLAT_M)
    along = directions(state.angle)[1][given.wall]
    middle = placed_ends(assembled).mean(axis=1) - state.centre[given.wall]
    piece = np.rint((middle * along).sum(axis=1) / PIECE_M).astype(np.int64)
    piece[given.sd < np.maximum(UNEVEN * sd, UNEVEN_M)] = 0
    wall = _numbered(given.wall, piece)
    piece[np.bincount(wall)[wall] < OFTEN] = 0
    wall = _numbered(given.wall, piece)
    if wall.max() == given.wall.max():
        return None
    corner = _numbered(given.corner, wall[given.corner_row])
    divided = replace(given, wall=wall, corner=corner, sd=sd)
    poses = assembled.poses(history.n_iterations)[assembled.iterations]
    return replace(assembled, given=divided, state=laid_out(divided, poses))


def _numbered(one: Ints, other: Ints) -> Ints:
    """Return the number of each pair (n,) of numbers, from 0."""
    pairs = np.column_stack([one, other])
    return np.unique(pairs, axis=0, return_inverse=True)[1].ravel()
