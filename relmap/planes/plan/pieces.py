"""Parts of walls in a floor plan, and their ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.plan.evidence import Stretches
from relmap.planes.walls.assembly import Assembled
from relmap.planes.walls.joining import CORNER_M

SHORTEST_M = 0.12
MEETING_M = 0.25
"""A wall that ends this close to another one is extended or cut to meet it."""
CROSSING = np.sin(np.deg2rad(30.0))
"""Walls that cross at a smaller angle (sine) have no well-defined crossing."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Parts of walls; n of them.

    `wall` (n,): compact number of the wall. `reach` (n, 2), metres: start and end along the wall.
    `corner` (n, 2): compact number of the corner at either end; -1 for none.
    """

    wall: Ints
    reach: Floats
    corner: Ints

    def __len__(self) -> int:
        return len(self.wall)

    @property
    def length_m(self) -> Floats:
        """Lengths, (n,) metres."""
        return np.asarray(self.reach[:, 1] - self.reach[:, 0])

    def only(self, rows: Bools | Ints) -> Pieces:
        """Return some of them."""
        return Pieces(self.wall[rows], self.reach[rows], self.corner[rows])

    def ends(self, walls: Stretches) -> Floats:
        """Return the end points; (n, 2, 2) map frame, metres."""
        base, along = walls.base[self.wall], walls.along[self.wall]
        return np.asarray(base[:, None] + self.reach[:, :, None] * along[:, None])


@dataclass(eq=False)
class _Part:
    """A piece during the assignment of corners: its extent, and the corners there."""

    wall: int
    reach: list[float]
    corner: list[int]

    def ends_at(self, end: int, place: float) -> bool:
        """Return whether a corner at a place may be this end without emptying the piece."""
        left_m = (self.reach[1 - end] - place) * (1 - 2 * end)
        return abs(self.reach[end] - place) <= CORNER_M and left_m > SHORTEST_M

    def cut(self, end: int, place: float, corner: int) -> _Part:
        """End at a corner, and return the part beyond."""
        rest = _Part(self.wall, self.reach.copy(), self.corner.copy())
        rest.reach[1 - end], rest.corner[1 - end] = place, -1
        self.reach[end], self.corner[end] = place, corner
        return rest


def with_corners(pieces: Pieces, walls: Assembled) -> Pieces:
    """Return pieces that end at the corners of their walls; a corner inside a piece splits it."""
    given = walls.given
    count = np.bincount(given.corner, minlength=len(walls.corners))
    side = np.zeros(len(walls.corners), dtype=np.int64)
    side[given.corner] = given.corner_end
    wall, place = walls.corner_wall.tolist(), walls.state.along.tolist()
    parts: dict[int, list[_Part]] = {}
    for k, reach in zip(pieces.wall.tolist(), pieces.reach.tolist(), strict=True):
        parts.setdefault(k, []).append(_Part(k, reach, [-1, -1]))
    for k in np.argsort(-count, kind="stable").tolist():  # most observations first
        own, end, at = parts.get(wall[k], []), int(side[k]), place[k]
        free = [part for part in own if part.corner[end] < 0]
        near = [part for part in free if part.ends_at(end, at)]
        if near:
            min(near, key=lambda part: abs(part.reach[end] - at)).cut(end, at, k)
        else:
            within = [part for part in free if part.reach[0] < at < part.reach[1]]
            own += [part.cut(end, at, k) for part in within]
    every = sorted(
        (part for own in parts.values() for part in own), key=lambda p: (p.wall, p.reach)
    )
    return Pieces(
        np.array([part.wall for part in every], dtype=np.int64),
        np.array([part.reach for part in every]).reshape(-1, 2),
        np.array([part.corner for part in every], dtype=np.int64).reshape(-1, 2),
    )


def met(pieces: Pieces, walls: Stretches) -> Pieces:
    """Return pieces that end exactly where they meet others.

    An end that is a corner stays where it was seen, and at most the shorter part is cut off.
    """
    if not len(pieces):
        return pieces
    base, along, normal = (each[pieces.wall] for each in (walls.base, walls.along, walls.normal))
    end, other = _beside(pieces, walls)
    own, side = end // 2, end % 2
    cross = (along[own] * normal[other]).sum(axis=1)
    rows = np.flatnonzero((np.abs(cross) > CROSSING) & (pieces.corner[own, side] < 0))
    own, side, other, cross = own[rows], side[rows], other[rows], cross[rows]
    place = ((base[other] - base[own]) * normal[other]).sum(axis=1) / cross
    there = ((base[own] + place[:, None] * along[own] - base[other]) * along[other]).sum(axis=1)
    off, left = (np.abs(place - pieces.reach[own, end]) for end in (side, 1 - side))
    low, high = pieces.reach[other].T
    meets = (
        (off < np.minimum(left, MEETING_M)) & (there > low - MEETING_M) & (there < high + MEETING_M)
    )
    order = np.flatnonzero(meets)[np.argsort(-off[meets], kind="stable")]
    reach = pieces.reach.copy()
    reach[own[order], side[order]] = place[order]  # the nearest is last
    found = Pieces(pieces.wall, reach, pieces.corner)
    return found.only(found.length_m > SHORTEST_M / 2)


def _beside(pieces: Pieces, walls: Stretches) -> tuple[Ints, Ints]:
    """Return ends (k,), two per piece, and the other pieces (k,) near them."""
    n = np.ceil(pieces.length_m / MEETING_M).astype(np.int64) + 1
    piece = np.repeat(np.arange(len(pieces)), n)
    share = (np.arange(len(piece)) - np.repeat(np.cumsum(n) - n, n)) / (n - 1)[piece]
    ends = pieces.ends(walls)
    points = ends[piece, 0] + share[:, None] * (ends[piece, 1] - ends[piece, 0])
    near: Any = cKDTree(points).query_ball_point(ends.reshape(-1, 2), 2 * MEETING_M)
    end = np.repeat(np.arange(len(near)), [len(found) for found in near])
    other = piece[np.concatenate(near).astype(np.int64)]
    pairs = np.unique(np.column_stack([end, other])[end // 2 != other], axis=0)
    return pairs[:, 0], pairs[:, 1]
