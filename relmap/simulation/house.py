"""Rooms in space, of one storey or two, and the way a sensor is carried through them.

Faces are rectangles, solid on both sides: a corner (3,) and two sides (3,), metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats

Face = tuple[ArrayLike, ArrayLike, ArrayLike]
DOOR = 3.0, 3.9, 2.0
"""Start and end of the door along the wall between the rooms, and its height, metres."""
CEILING_M, STOREY_M, RIDGE_M, EAVES_M = 2.7, 3.0, 6.2, 4.6
"""Heights of the lower ceiling, the upper floor, the ridge and the eaves of a house."""
STEPS, RISE_M, TREAD_M = 15, 0.2, 0.28
"""Steps of the stairs, the last of which is the upper floor, and height and depth of each."""
STAIRS = 10.8, 1.2
"""Left side and foot of the stairs, which lead up along the outer wall."""
OPENING = 1.6, STAIRS[1] + (STEPS - 1) * TREAD_M
"""Start and end of the opening of the ceiling above the stairs."""
RAILING_M = 1.0
BOX = 0.8, 0.6, 1.1
"""Length, width and height of a moving box."""


@dataclass(frozen=True, eq=False)
class House:
    """Rooms: `origin` (f, 3), a corner of each face; `sides` (f, 2, 3); `stops` (s, 3) of a path.

    `tracks`: start and end, on the floor, of the ways that boxes are moved to and fro.
    """

    origin: Floats
    sides: Floats
    stops: Floats
    tracks: Floats


def house(storeys: int) -> House:
    """Return two rooms, or with two storeys four, joined by stairs."""
    faces, stops, tracks = _one_storey() if storeys == 1 else _two_storeys()
    array = np.array(faces, dtype=np.float64)
    return House(array[:, 0], array[:, 1:], np.array(stops), np.array(tracks))


def moving_box(track: Floats, share: float) -> tuple[Floats, Floats]:
    """Return the faces, as in `House`, of a box this far along its track (2, 3)."""
    way = track[1] - track[0]
    faces = _box(track[0] + share * way, *BOX, float(np.arctan2(way[1], way[0])))
    array = np.array(faces)
    return array[:, 0], array[:, 1:]


def _one_storey() -> tuple[list[Face], list[ArrayLike], list[ArrayLike]]:
    """Return the faces, stops and tracks of two rooms, the second with a sloped roof."""
    faces: list[Face] = [
        ((0, 0, 0), (12, 0, 0), (0, 7, 0)),  # floor
        ((0, 0, 2.7), (6, 0, 0), (0, 7, 0)),  # ceiling of the first room
        ((6, 0, 3.4), (6, 0, 0), (0, 7, -1.9)),  # sloped roof of the second
        *_outer_walls(3.5, 3.5),
        *_wall_with_door(0.0, 3.5),
    ]
    for x, y, z, wide, deep, tall, turn in (
        (1.2, 5.2, 0.65, 1.6, 0.9, 0.1, 0.3),  # tables: thick boards
        (8.5, 2.2, 0.7, 1.8, 1.0, 0.1, -0.4),
        (0.2, 0.2, 0.0, 0.6, 1.5, 1.9, 0.0),  # cupboards
        (10.3, 5.6, 0.0, 1.2, 0.8, 1.1, 0.2),
    ):
        faces += _box(np.array([x, y, z]), wide, deep, tall, turn)
    stops: list[ArrayLike] = [
        (1.8, 2.0, 1.3), (3.5, 3.6, 1.5), (6.0, 3.45, 1.4), (8.0, 4.2, 1.3), (10.4, 3.4, 1.5)
    ]  # fmt: skip
    return faces, stops, [((4.6, 0.5, 0.0), (4.6, 5.5, 0.0)), ((7.0, 5.4, 0.0), (10.0, 5.4, 0.0))]


def _two_storeys() -> tuple[list[Face], list[ArrayLike], list[ArrayLike]]:
    """Return the faces, stops and tracks of a house with stairs and a gable roof."""
    left, foot = STAIRS
    begin, end = OPENING
    faces: list[Face] = [
        ((0, 0, 0), (12, 0, 0), (0, 7, 0)),
        ((0, 0, EAVES_M), (12, 0, 0), (0, 3.5, RIDGE_M - EAVES_M)),  # roof
        ((0, 7, EAVES_M), (12, 0, 0), (0, -3.5, RIDGE_M - EAVES_M)),
        *_outer_walls(EAVES_M, RIDGE_M),
        *_wall_with_door(0.0, CEILING_M),
        *_wall_with_door(STOREY_M, RIDGE_M - STOREY_M),
    ]
    for z in (CEILING_M, STOREY_M):
        faces += [
            ((0, 0, z), (left, 0, 0), (0, 7, 0)),
            ((left, 0, z), (12 - left, 0, 0), (0, begin, 0)),
            ((left, end, z), (12 - left, 0, 0), (0, 7 - end, 0)),
        ]
    high = STOREY_M + RAILING_M - CEILING_M
    faces += [
        ((left, begin, CEILING_M), (0, end - begin, 0), (0, 0, high)),  # railing
        ((left, begin, CEILING_M), (12 - left, 0, 0), (0, 0, high)),
    ]
    for k in range(STEPS):
        y, z = foot + k * TREAD_M, k * RISE_M
        faces.append(((left, y, z), (12 - left, 0, 0), (0, 0, RISE_M)))
        if k < STEPS - 1:
            faces.append(((left, y, z + RISE_M), (12 - left, 0, 0), (0, TREAD_M, 0)))
            faces.append(((left, y, 0), (0, TREAD_M, 0), (0, 0, z + RISE_M)))  # beside the step
    for x, y, z, wide, deep, tall, turn in (
        (1.2, 5.2, 0.65, 1.6, 0.9, 0.1, 0.3),  # tables: thick boards
        (7.4, 5.2, 0.7, 1.8, 1.0, 0.1, -0.4),
        (0.2, 0.2, 0.0, 0.6, 1.5, 1.9, 0.0),  # cupboards
        (6.8, 0.2, 0.0, 1.6, 0.5, 2.1, 0.0),
        (7.0, 5.6, STOREY_M, 1.4, 0.6, 1.2, 0.1),
        (1.0, 4.6, STOREY_M, 2.0, 1.5, 0.5, 0.2),  # bed
    ):
        faces += _box(np.array([x, y, z]), wide, deep, tall, turn)
    top = STOREY_M + 1.4
    stops: list[ArrayLike] = [
        (1.8, 2.0, 1.3), (3.5, 3.5, 1.5), (6.0, 3.45, 1.4), (8.5, 3.2, 1.4), (10.6, 0.6, 1.4),
        (11.4, 0.8, 1.4), (11.4, end, top), (11.2, 6.1, top), (9.5, 5.0, top), (6.0, 3.45, top),
        (3.5, 3.0, top), (1.6, 2.2, top),
    ]  # fmt: skip
    tracks: list[ArrayLike] = [
        ((4.6, 0.5, 0.0), (4.6, 5.5, 0.0)),
        ((9.9, 5.4, 0.0), (9.9, 2.4, 0.0)),
        ((4.2, 0.5, STOREY_M), (4.2, 5.5, STOREY_M)),
    ]
    return faces, stops, tracks


def _outer_walls(side_m: float, gable_m: float) -> list[Face]:
    return [
        ((0, 0, 0), (12, 0, 0), (0, 0, side_m)),
        ((0, 7, 0), (12, 0, 0), (0, 0, side_m)),
        ((0, 0, 0), (0, 7, 0), (0, 0, gable_m)),
        ((12, 0, 0), (0, 7, 0), (0, 0, gable_m)),
    ]


def _wall_with_door(z: float, tall: float) -> list[Face]:
    begin, end, high = DOOR
    return [
        ((6, 0, z), (0, begin, 0), (0, 0, tall)),
        ((6, end, z), (0, 7 - end, 0), (0, 0, tall)),
        ((6, begin, z + high), (0, end - begin, 0), (0, 0, tall - high)),
    ]


def _box(corner: Floats, wide: float, deep: float, tall: float, turn: float) -> list[Face]:
    u = wide * np.array([np.cos(turn), np.sin(turn), 0.0])
    v = deep * np.array([-np.sin(turn), np.cos(turn), 0.0])
    w = np.array([0.0, 0.0, tall])
    sides = [(u, v), (u, w), (v, w)]
    far = [corner + opposite for opposite in (w, v, u)]
    return [(at, a, b) for at, (a, b) in zip([corner] * 3 + far, sides * 2, strict=True)]
