"""Parts of walls in a floor plan, and their ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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

    def only(self, rows: Bools | Ints) -> Pieces:
        """Return some of them."""
        return Pieces(self.wall[rows], self.reach[rows], self.corner[rows])


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
    base, along, normal = (each[pieces.wall] for each in (walls.base, walls.along, walls.normal))
    reach, (low, high) = pieces.reach.copy(), pieces.reach.T
    for k, end in np.argwhere(pieces.corner < 0).tolist():
        cross = (along[k] * normal).sum(axis=1)
        cross[np.abs(cross) <= CROSSING] = np.nan
        place = ((base - base[k]) * normal).sum(axis=1) / cross
        there = ((base[k] + place[:, None] * along[k] - base) * along).sum(axis=1)
        off, left = (np.abs(place - pieces.reach[k, side]) for side in (end, 1 - end))
        meets = (there > low - MEETING_M) & (there < high + MEETING_M)
        meets &= off < np.minimum(left, MEETING_M)
        if meets.any():
            reach[k, end] = place[np.argmin(np.where(meets, off, np.inf))]
    found = Pieces(pieces.wall, reach, pieces.corner)
    return found.only(reach[:, 1] - reach[:, 0] > SHORTEST_M / 2)
