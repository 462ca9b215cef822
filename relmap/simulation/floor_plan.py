"""The worlds of vertical walls by name, and those in the open: panels, or one long wall."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from relmap.simulation import corridors, rooms
from relmap.simulation.shapes import FloorPlan, panels, rounded

World = Literal[
    "building",
    "panels",
    "long-wall",
    "oblique",
    "glass",
    "furniture",
    "twin-rooms",
    "corridor",
    "bare-corridor",
    "curved",
]
"""Worlds: corridors and rooms of a "building", without right angles if "oblique", with panes of
"glass" or with "furniture"; free-standing "panels" only; a "long-wall" that stands alone, then
panels; "twin-rooms", all the same, which the robot enters; a square "corridor" of sides that are
the same; "bare-corridor", without features; "curved"."""

FIELD_M = 12.0
FIELD_LOOP_M = 7.0
FIELD_PANELS = 40
"""Panels in the open, within `FIELD_M` of the middle of a circular path."""
LONG_WALL = np.array([8.0, -1.6, 26.0, -1.6])
LONG_LOOP = np.array([0.0, 0.0, 32.0, 9.0])
"""Beside one side of this closed path a long wall stands alone, ..."""
LONG_BARE = np.array([7.0, -8.0, 27.0, 6.4])
"""... with nothing else in this rectangle; around it, and beyond, are panels."""
LONG_FIELD = np.array([-7.0, -8.0, 39.0, 17.0])
LONG_PANELS = 70
HEIGHT_M = (2.4, 3.0)


def make_floor_plan(world: World, rng: np.random.Generator) -> FloorPlan:
    """Draw a world."""
    plan = {
        "building": rooms.building,
        "panels": _field,
        "long-wall": _long_wall,
        "oblique": rooms.oblique,
        "glass": lambda rng: rooms.building(rng, glass=True),
        "furniture": rooms.furnished,
        "twin-rooms": lambda _: corridors.twin_rooms(),
        "corridor": lambda _: corridors.corridor(),
        "bare-corridor": lambda _: corridors.bare_corridor(),
        "curved": corridors.curved,
    }[world](rng)
    height = np.tile([0.0, rng.uniform(*HEIGHT_M)], (len(plan.walls), 1))
    return replace(plan, walls=np.hstack([plan.walls, height]))


def _field(rng: np.random.Generator) -> FloorPlan:
    square = FIELD_M * np.array([-1.0, -1.0, 1.0, 1.0])
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius = FIELD_LOOP_M * (1 + 0.12 * np.sin(2 * angle + rng.uniform(0, 2 * np.pi)))
    loop = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    way = np.hstack([loop[::4], np.roll(loop[::4], -1, axis=0)])
    return FloorPlan(panels(square, FIELD_PANELS, rng, obstacles=way), square[None], loop)


def _long_wall(rng: np.random.Generator) -> FloorPlan:
    """Draw a long wall that stands alone, then panels.

    Half way along it a robot sees nothing but a part of it, and none of its ends.
    """
    loop = rounded(LONG_LOOP)
    way = np.hstack([loop[::4], np.roll(loop[::4], -1, axis=0)])
    placed = panels(LONG_FIELD, LONG_PANELS, rng, obstacles=np.vstack([way, LONG_WALL]))
    ends = placed.reshape(-1, 2, 2)
    inside = (ends > LONG_BARE[:2]) & (ends < LONG_BARE[2:])
    bare = np.any(np.all(inside, axis=2), axis=1)
    return FloorPlan(np.vstack([LONG_WALL, placed[~bare]]), LONG_FIELD[None], loop)
