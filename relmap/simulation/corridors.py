"""Corridors that are hard to map: repetitive, featureless, with twin rooms, or curved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from relmap.core.arrays import Floats
from relmap.simulation.rooms import CORRIDOR_M
from relmap.simulation.shapes import NOTHING, FloorPlan, cut, edges, ring, rounded

WIDTH_M, DEPTH_M, DOOR_M = 4.0, 4.5, 1.1
"""Size of all twin rooms."""
TWINS = 3
"""Twin rooms on either side of their corridor."""
ALIKE_M, DOORS, DOOR_STEP_M, LEAF_M, NICHE_M = 20.0, 6, 3.0, 0.9, 0.15
"""Length of each of four identical corridors; closed doors on either side, and their depth."""
LANE_M, ROUND_M = 0.5, 1.1
"""Distance of the robot from the centre line of the corridor, and radius of its loop in each
room."""
BARE_M = 26.0
"""Length of a featureless corridor: more than twice the range of the laser."""
RADIUS_M, STRAIGHT_M, CHORD_M = 6.0, 4.0, 0.1
"""Size of the outer wall of a curved corridor, approximated by chords."""
PILLAR_M, PILLARS = (0.3, 0.25), 5
"""Width and depth of the pilasters on the outer wall, and how many there are in a half circle."""


def twin_rooms() -> FloorPlan:
    """Draw a corridor between identical rooms; the robot drives round in each."""
    hall = np.array([0.0, -CORRIDOR_M / 2, TWINS * WIDTH_M, CORRIDOR_M / 2])
    sides, places = [], []
    for k in range(TWINS):
        low = hall[0] + k * WIDTH_M
        room = np.array([low, hall[1] - DEPTH_M, low + WIDTH_M, hall[1]])
        door = low + WIDTH_M / 2 + np.array([DOOR_M / 2, -DOOR_M / 2])
        places.append(np.column_stack([door, np.full(2, hall[1])]))
        sides += [cut(edge, places[-1][None]) for edge in edges(room)]
    walls, doors = np.vstack(sides), np.array(places)
    way = np.vstack([_way_round(x, hall[1]) for x in doors[:, :, 0].mean(axis=1)])
    middle = (hall[:2] + hall[2:]) / 2
    both, all_doors = (
        np.concatenate([parts, middle - (parts - middle)])
        for parts in (walls.reshape(-1, 2, 2), doors)
    )
    fronts = [cut(edge, all_doors) for edge in edges(hall)]
    loop = np.vstack([way, middle - (way - middle)])
    return FloorPlan(np.vstack([both.reshape(-1, 4), *fronts]), NOTHING, loop, all_doors)


def corridor() -> FloorPlan:
    """Draw a square corridor with four identical sides and identical closed doors."""
    return _square(ALIKE_M, _with_doors)


def bare_corridor() -> FloorPlan:
    """Draw a square corridor without doors: half way along a side no end is in range."""
    return _square(BARE_M, lambda side: side.reshape(1, 4))


def _square(size_m: float, walls_of: Callable[[Floats], Floats]) -> FloorPlan:
    """Return a corridor round a square block, given the walls (w, 4) of each side (2, 2)."""
    block = np.array([0.0, 0.0, size_m, size_m])
    hall = block + CORRIDOR_M * np.array([-1, -1, 1, 1])
    walls = np.vstack([walls_of(side) for side in (*edges(hall), *edges(block)[:, ::-1])])
    return FloorPlan(walls, ring(hall, block), rounded((hall + block) / 2))


def curved(rng: np.random.Generator) -> FloorPlan:
    """Draw a corridor between two walls that are half circles joined by straight lines."""
    outer, inner = _stadium(RADIUS_M), _stadium(RADIUS_M - CORRIDOR_M)[::-1]
    around = [np.hstack([line, np.roll(line, -1, axis=0)]) for line in (outer, inner)]
    pillars = [
        _pillar(end, (k + rng.uniform(0.2, 0.8)) * np.pi / PILLARS - np.pi / 2)
        for end in range(2)
        for k in range(PILLARS)
    ]
    return FloorPlan(np.vstack([*around, *pillars]), NOTHING, _stadium(RADIUS_M - CORRIDOR_M / 2))


def _with_doors(edge: Floats) -> Floats:
    """Return a wall (2, 2) as the parts (w, 4) between doors, their jambs, and the doors."""
    length = float(np.linalg.norm(edge[1] - edge[0]))
    along = (edge[1] - edge[0]) / length
    away = NICHE_M * np.array([along[1], -along[0]])
    spots = [edge[0]]
    for middle in (np.arange(DOORS) - (DOORS - 1) / 2) * DOOR_STEP_M + length / 2:
        right, left = (edge[0] + (middle + half) * along for half in (-LEAF_M / 2, LEAF_M / 2))
        spots += [right, right + away, left + away, left]
    way = np.array([*spots, edge[1]])
    return np.hstack([way[:-1], way[1:]])


def _way_round(x: float, front: float) -> Floats:
    """Return the path (n, 2) from the corridor into the room below x, round, and out again."""
    angle = np.linspace(np.pi / 2, 2.5 * np.pi, 60)
    middle = np.array([x, front - DEPTH_M / 2])
    around = middle + ROUND_M * np.column_stack([np.cos(angle), np.sin(angle)])
    aside, lane = 0.15, front + CORRIDOR_M / 2 - LANE_M
    into, out = np.array([[x - aside, lane]]), np.array([[x + aside, lane]])
    return np.vstack([into, around, out])


def _stadium(radius: float) -> Floats:
    """Return the points of two half circles, counter-clockwise; two straight lines join them."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, round(np.pi * radius / CHORD_M))
    arc = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    right = arc + np.array([STRAIGHT_M / 2, 0.0])
    return np.vstack([right, -right])


def _pillar(end: int, angle: float) -> Floats:
    """Return the three sides (3, 4) of a pilaster at the outer wall of one of two half circles."""
    outwards = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([-outwards[1], outwards[0]]) * PILLAR_M[0] / 2
    foot = np.sqrt(RADIUS_M**2 - (PILLAR_M[0] / 2) ** 2) - CHORD_M / 10
    top = foot - PILLAR_M[1]
    ways = ((foot, -along), (top, -along), (top, along), (foot, along))
    corners = np.array([outwards * away + aside for away, aside in ways])
    corners += [STRAIGHT_M / 2, 0.0]
    return np.hstack([corners[:-1], corners[1:]]) * (1 - 2 * end)
