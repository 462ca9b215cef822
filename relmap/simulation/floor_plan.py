"""The world of vertical walls: a building of corridors and rooms, panels, or one long wall.

A wall is the segment (x0, y0) to (x1, y1) from z0 to z1. Its front is to the left of the way from
the first end to the second, so that its ends go from right to left as seen from there. A thin wall
between two rooms is two walls, one for each side.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from relmap.simulation.noise import Array

World = Literal["building", "panels", "long-wall"]

CORRIDOR_M = 2.4
"""Width of the corridor round a block of rooms; more rooms lie along its outer side."""
TURN_RADIUS_M = 1.8
"""The robot drives in the middle of the corridor and rounds its corners with this radius."""
BLOCK_M = ((13.0, 18.0), (7.0, 10.0))
ROOM_M = (3.4, 5.0)
"""Least and greatest width: the narrowest holds the widest door between two posts."""
DEPTH_M = (3.5, 5.5)
DOOR_M = (0.9, 1.3)
POST_M = 0.8
"""Least length of the wall on either side of a door."""
PANEL_M = (0.8, 2.0)
MOST_PANELS = 2
"""Most free-standing panels in a room."""
CLEARANCE_M = 0.6
"""Least distance of a panel from other walls, and of the robot from all walls."""
FIELD_M = 12.0
FIELD_LOOP_M = 7.0
FIELD_PANELS = 40
"""Panels in the open, within `FIELD_M` of the middle of a round way."""
LONG_WALL = np.array([8.0, -1.6, 26.0, -1.6])
LONG_LOOP = np.array([0.0, 0.0, 32.0, 9.0])
"""Beside one side of this round way a long wall stands alone, ..."""
LONG_BARE = np.array([7.0, -8.0, 27.0, 6.4])
"""... with nothing else in this rectangle; around it, and beyond, are panels."""
LONG_FIELD = np.array([-7.0, -8.0, 39.0, 17.0])
LONG_PANELS = 70
HEIGHT_M = (2.4, 3.0)
TRIALS = 30
"""Tries to find a place for a panel."""
NOTHING: Array = np.empty((0, 4))


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """Walls, where a robot may be, and the closed line it drives.

    Attributes
    ----------
    walls : (w, 6) float64, map frame, metres
        x0, y0, x1, y1, z0, z1; they touch but do not cross, and all have the same z0 and z1.
    floors : (f, 4) float64, metres
        Rectangles x_low, y_low, x_high, y_high without fixed walls inside.
    loop : (l, 2) float64, metres
        The line, counter-clockwise; from the last point it goes back to the first.
    doors : (d, 2, 2) float64, metres
        Both jambs of each door; the room is to the left of the way from the first to the second.
    """

    walls: NDArray[np.float64]
    floors: NDArray[np.float64]
    loop: NDArray[np.float64]
    doors: NDArray[np.float64]


def make_floor_plan(world: World, rng: np.random.Generator) -> FloorPlan:
    """Draw a world: a building, panels only, or a long wall among panels."""
    draw = {"building": _building, "panels": _field, "long-wall": _long_wall}[world]
    flat, floors, loop, doors = draw(rng)
    height = np.tile([0.0, rng.uniform(*HEIGHT_M)], (len(flat), 1))
    return FloorPlan(np.hstack([flat, height]), floors, loop, doors)


def wall_distances(points: Array, walls: Array) -> Array:
    """Return the distances (n, w) of points (n, 2) from walls (w, 4 or more), metres."""
    first, along = walls[:, :2], walls[:, 2:4] - walls[:, :2]
    offset = points[:, None] - first
    t = np.clip((offset * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - t[..., None] * along, axis=2))


def _building(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return the walls (w, 4), floors, loop and doors of a corridor round a block, with rooms."""
    block = np.array([0.0, 0.0, rng.uniform(*BLOCK_M[0]), rng.uniform(*BLOCK_M[1])])
    hall = block + CORRIDOR_M * np.array([-1, -1, 1, 1])
    placed = _rooms_inside(block, rng)
    placed += [room for side in range(4) for room in _rooms_along(hall, side, rng)]
    rooms = np.array([room for room, _ in placed])
    doors = np.array([_door(_edges(room)[side], rng) for room, side in placed])
    pairs = zip(rooms, doors[:, None], strict=True)
    walls = [_cut(edge, door) for room, door in pairs for edge in _edges(room)]
    walls += [_cut(edge, doors) for edge in (*_edges(hall), *_edges(block)[:, ::-1])]
    panels = [_panels(room, int(rng.integers(MOST_PANELS + 1)), rng) for room in rooms]
    floors = np.vstack([rooms, _ring(hall, block)])
    return np.vstack([*walls, *panels]), floors, _rounded((hall + block) / 2), doors


def _field(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return the walls (w, 4), floors, loop and doors, none, of panels in the open."""
    square = FIELD_M * np.array([-1.0, -1.0, 1.0, 1.0])
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius = FIELD_LOOP_M * (1 + 0.12 * np.sin(2 * angle + rng.uniform(0, 2 * np.pi)))
    loop = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    way = np.hstack([loop[::4], np.roll(loop[::4], -1, axis=0)])
    panels = _panels(square, FIELD_PANELS, rng, obstacles=way)
    return panels, square[None], loop, np.empty((0, 2, 2))


def _long_wall(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return walls, floors, loop and no doors: a long wall that stands alone, then panels.

    Half way along it a robot sees nothing but a part of it, and none of its ends.
    """
    loop = _rounded(LONG_LOOP)
    way = np.hstack([loop[::4], np.roll(loop[::4], -1, axis=0)])
    panels = _panels(LONG_FIELD, LONG_PANELS, rng, obstacles=np.vstack([way, LONG_WALL]))
    ends = panels.reshape(-1, 2, 2)
    inside = (ends > LONG_BARE[:2]) & (ends < LONG_BARE[2:])
    bare = np.any(np.all(inside, axis=2), axis=1)
    walls = np.vstack([LONG_WALL, panels[~bare]])
    return walls, LONG_FIELD[None], loop, np.empty((0, 2, 2))


def _rooms_inside(block: Array, rng: np.random.Generator) -> list[tuple[Array, int]]:
    """Return rooms side by side, each with the side of its door: below or above."""
    splits = _split(block[0], block[2], rng)
    return [
        (np.array([low, block[1], high, block[3]]), 2 * int(rng.integers(2)))
        for low, high in pairwise(splits)
    ]


def _rooms_along(hall: Array, side: int, rng: np.random.Generator) -> list[tuple[Array, int]]:
    """Return rooms beyond one side of the hall, each with the side of its door."""
    across = 1 - side % 2
    along = 1 - across
    splits = _split(hall[along], hall[along + 2], rng)
    rooms = []
    for low, high in pairwise(splits):
        depth = rng.uniform(*DEPTH_M)
        room = np.empty(4)
        room[[along, along + 2]] = low, high
        if side in (0, 3):
            room[[across, across + 2]] = hall[across] - depth, hall[across]
        else:
            room[[across, across + 2]] = hall[across + 2], hall[across + 2] + depth
        rooms.append((room, (side + 2) % 4))
    return rooms


def _split(low: float, high: float, rng: np.random.Generator) -> Array:
    """Return the limits of parts of an interval that are about as wide as rooms."""
    count = int((high - low) / np.mean(ROOM_M))
    cuts = np.cumsum(rng.uniform(*ROOM_M, count))
    return np.concatenate([[low], low + (high - low) * cuts[:-1] / cuts[-1], [high]])


def _edges(box: Array) -> Array:
    """Return the sides (4, 2, 2) of a rectangle, counter-clockwise: below, right, above, left."""
    corners = box[np.array([[0, 1], [2, 1], [2, 3], [0, 3]])]
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _door(edge: Array, rng: np.random.Generator) -> Array:
    """Return a door (2, 2) at a random place of a wall (2, 2)."""
    length = float(np.linalg.norm(edge[1] - edge[0]))
    width = rng.uniform(*DOOR_M)
    begin = rng.uniform(POST_M, length - POST_M - width)
    t = np.array([[begin], [begin + width]]) / length
    return np.asarray(edge[0] + t * (edge[1] - edge[0]))


def _cut(edge: Array, doors: Array) -> Array:
    """Return what doors (d, 2, 2) leave of a wall (2, 2), as rows x0, y0, x1, y1."""
    along = edge[1] - edge[0]
    offset = doors - edge[0]
    t = offset @ along / (along @ along)
    away = np.abs(offset[..., 0] * along[1] - offset[..., 1] * along[0])
    here = ((away < 1e-9) & (t > 0) & (t < 1)).all(axis=1)
    gaps = doors[here].reshape(-1, 2)[np.argsort(t[here], axis=None)]
    return np.vstack([edge[:1], gaps, edge[1:]]).reshape(-1, 4)


def _panels(box: Array, count: int, rng: np.random.Generator, obstacles: Array = NOTHING) -> Array:
    """Place panels in a rectangle, clear of its sides, of one another and of obstacles (o, 4).

    Returns
    -------
    (2 p, 4) float64
        Both sides of each; there are fewer than `count` where they do not fit.
    """
    low, high = box[:2] + CLEARANCE_M, box[2:] - CLEARANCE_M
    tries = count * TRIALS
    middle = rng.uniform(low, high, (tries, 2))
    yaw, length = rng.uniform(0, np.pi, tries), rng.uniform(*PANEL_M, tries)
    half = length[:, None] / 2 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    inside = ((np.abs(half) < middle - low) & (np.abs(half) < high - middle)).all(axis=1)
    placed = [NOTHING]
    for k in np.flatnonzero(inside):
        if len(placed) > count:
            break
        points = middle[k] + np.linspace(-1, 1, 21)[:, None] * half[k]
        if (wall_distances(points, np.vstack([obstacles, *placed])) > CLEARANCE_M).all():
            right, left = middle[k] - half[k], middle[k] + half[k]
            placed.append(np.array([[*right, *left], [*left, *right]]))
    return np.vstack(placed)


def _ring(hall: Array, block: Array) -> Array:
    """Return the four rectangles (4, 4) between two."""
    (x0, y0, x1, y1), (a0, b0, a1, b1) = hall, block
    return np.array([[x0, y0, x1, b0], [x0, b1, x1, y1], [x0, b0, a0, b1], [a1, b0, x1, b1]])


def _rounded(box: Array) -> Array:
    """Return a rectangle with rounded corners as a dense line, counter-clockwise."""
    quarter = np.linspace(-np.pi / 2, 0, 60)
    arcs = []
    for k, corner in enumerate(_edges(box)[:, 1]):
        angle = quarter + k * np.pi / 2
        inward = np.sign((box[:2] + box[2:]) / 2 - corner)
        middle = corner + TURN_RADIUS_M * inward
        arcs.append(middle + TURN_RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.vstack(arcs)
