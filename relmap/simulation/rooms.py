"""The building: corridors round a block of rooms, and more rooms along their outer side."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from relmap.core.arrays import Floats
from relmap.simulation.shapes import NOTHING, FloorPlan, boxes, cut, edges, panels, ring, rounded

CORRIDOR_M = 2.4
"""Width of the corridor round a block of rooms; further rooms lie along its outer side."""
BLOCK_M = ((13.0, 18.0), (7.0, 10.0))
ROOM_M = (3.4, 5.0)
"""Minimum and maximum width: the narrowest holds the widest door between two posts."""
DEPTH_M = (3.5, 5.5)
DOOR_M = (0.9, 1.3)
POST_M = 0.8
"""Minimum length of the wall on either side of a door."""
FRAME_M = 0.15
"""The same for a pane."""
MOST_PANELS = 2
"""Maximum number of free-standing panels in a room."""
PIECES = (2, 5)
"""Minimum number of pieces of furniture on a floor, and one more than the maximum."""
SHEAR, TAPER = (0.15, 0.35), (0.05, 0.15)
"""Lean of walls, and their convergence over half the building."""


def building(rng: np.random.Generator, glass: bool = False) -> FloorPlan:
    """Draw a corridor round a block, with rooms and, on request, a pane beside each door."""
    block = np.array([0.0, 0.0, rng.uniform(*BLOCK_M[0]), rng.uniform(*BLOCK_M[1])])
    hall = block + CORRIDOR_M * np.array([-1, -1, 1, 1])
    placed = [
        (np.array([low, block[1], high, block[3]]), 2 * int(rng.integers(2)))
        for low, high in pairwise(_split(block[0], block[2], rng))
    ]
    placed += [room for side in range(4) for room in _rooms_along(hall, side, rng)]
    rooms = np.array([room for room, _ in placed])
    fronts = [edges(room)[side] for room, side in placed]
    doors = np.array([_door(front, rng) for front in fronts])
    panes = np.array([_pane(front, door) for front, door in zip(fronts, doors, strict=True)])
    panes = panes if glass else panes[:0]
    gaps = np.concatenate([doors, panes])
    walls = [
        cut(edge, gaps[k :: len(rooms)]) for k, room in enumerate(rooms) for edge in edges(room)
    ]
    walls += [cut(edge, gaps) for edge in (*edges(hall), *edges(block)[:, ::-1])]
    walls += [panels(room, int(rng.integers(MOST_PANELS + 1)), rng) for room in rooms]
    opaque, both = np.vstack(walls), np.concatenate([panes, panes[:, ::-1]]).reshape(-1, 4)
    rows = len(opaque) + np.arange(len(both))
    floors, loop = np.vstack([rooms, ring(hall, block)]), rounded((hall + block) / 2)
    return FloorPlan(np.vstack([opaque, both]), floors, loop, doors, rows)


def _rooms_along(hall: Floats, side: int, rng: np.random.Generator) -> list[tuple[Floats, int]]:
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


def _split(low: float, high: float, rng: np.random.Generator) -> Floats:
    """Return the limits of parts of an interval that are about as wide as rooms."""
    count = int((high - low) / np.mean(ROOM_M))
    cuts = np.cumsum(rng.uniform(*ROOM_M, count))
    return np.concatenate([[low], low + (high - low) * cuts[:-1] / cuts[-1], [high]])


def _door(edge: Floats, rng: np.random.Generator) -> Floats:
    """Return a door (2, 2) at a random place of a wall (2, 2)."""
    length = float(np.linalg.norm(edge[1] - edge[0]))
    width = rng.uniform(*DOOR_M)
    begin = rng.uniform(POST_M, length - POST_M - width)
    t = np.array([[begin], [begin + width]]) / length
    return np.asarray(edge[0] + t * (edge[1] - edge[0]))


def _pane(edge: Floats, door: Floats) -> Floats:
    """Return a pane (2, 2) in the longer part of a wall beside a door, between two frames."""
    parts = np.array([[edge[0], door[0]], [door[1], edge[1]]])
    right, left = parts[np.argmax(np.linalg.norm(parts[:, 1] - parts[:, 0], axis=1))]
    frame = FRAME_M * (left - right) / np.linalg.norm(left - right)
    return np.array([right + frame, left - frame])


def furnished(rng: np.random.Generator) -> FloorPlan:
    """Draw a building with boxes for furniture."""
    plan = building(rng)
    for floor in plan.floors:
        more = boxes(plan, floor, int(rng.integers(*PIECES)), rng)
        plan = replace(plan, walls=np.vstack([plan.walls, more]))
    return plan


def oblique(rng: np.random.Generator) -> FloorPlan:
    """Draw a building without right angles or parallel walls: a projective image of another."""
    plan = building(rng)
    low, high = plan.loop.min(axis=0), plan.loop.max(axis=0)
    scale_m, shear = np.linalg.norm(high - low) / 2, rng.uniform(*SHEAR) * rng.choice([-1, 1])
    away = rng.uniform(*TAPER) * rng.choice([-1, 1], 2)

    def moved(points: Floats) -> Floats:
        u = (points - (low + high) / 2) / scale_m
        sheared = u + shear * u[..., 1:] * [1.0, 0.0]
        return np.asarray(scale_m * sheared / (1 + u @ away)[..., None])

    walls = moved(plan.walls.reshape(-1, 2, 2)).reshape(-1, 4)
    return FloorPlan(walls, NOTHING, moved(plan.loop), moved(plan.doors))
