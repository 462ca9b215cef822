"""The worlds of vertical walls by name, those in the open: panels, or one long wall; moving walls.

Doors swing into their rooms, and panels slide and turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.simulation import corridors, rooms
from relmap.simulation.rooms import DOOR_M
from relmap.simulation.shapes import CLEARANCE_M, FloorPlan, panels, rounded, wall_distances

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
OPEN_RAD = np.deg2rad(65.0)
SWING_RAD = np.deg2rad(40.0)
"""Amplitude of a door about its half-open angle."""
SLIDE_M = 0.22
TURN_RAD = np.deg2rad(12.0)
"""Amplitude of sliding and turning of a panel, and its clearance."""
PERIOD = (30.0, 60.0)
"""Period, in scans."""
AJAR_M = 0.02
"""Distance of a door's leaf from its jamb."""


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
    """Draw a long wall of which a robot half way along it sees no end, then panels."""
    loop = rounded(LONG_LOOP)
    way = np.hstack([loop[::4], np.roll(loop[::4], -1, axis=0)])
    placed = panels(LONG_FIELD, LONG_PANELS, rng, obstacles=np.vstack([way, LONG_WALL]))
    ends = placed.reshape(-1, 2, 2)
    inside = (ends > LONG_BARE[:2]) & (ends < LONG_BARE[2:])
    bare = np.any(np.all(inside, axis=2), axis=1)
    return FloorPlan(np.vstack([LONG_WALL, placed[~bare]]), LONG_FIELD[None], loop)


@dataclass(frozen=True, eq=False)
class MovingWalls:
    """Walls that rotate about a pivot and slide, sinusoidally with the scan number; r walls.

    `row` (r,): rows of the walls in the plan; `pivot` (r, 2), metres; `slide_m` (r, 2): amplitudes
    of rotation and translation; `period`, `phase` (r,): scans, and radians.
    """

    row: Ints
    pivot: Floats
    swing_rad: float
    slide_m: Floats
    period: Floats
    phase: Floats

    def at(self, walls: Floats, iteration: int) -> Floats:
        """Return all walls (w, 6) of the plan at the time of one scan."""
        if not len(self.row):
            return walls
        share = np.sin(2 * np.pi * iteration / self.period + self.phase)
        c, s = np.cos(share * self.swing_rad)[:, None], np.sin(share * self.swing_rad)[:, None]
        x, y = np.moveaxis(walls[self.row, :4].reshape(-1, 2, 2) - self.pivot[:, None], -1, 0)
        turned = np.stack([c * x - s * y, s * x + c * y], axis=-1)
        moved = walls.copy()
        there = turned + (self.pivot + share[:, None] * self.slide_m)[:, None]
        moved[self.row, :4] = there.reshape(-1, 4)
        return moved


def make_moving(
    plan: FloorPlan, world: World, count: int, rng: np.random.Generator
) -> tuple[FloorPlan, MovingWalls]:
    """Make panels slide and turn, or add doors to a building.

    `count`: number; fewer doors if there is less space, fewer panels if there are fewer. Returns
    the plan with the doors, each with two sides, after the other walls.
    """
    if world == "panels":
        chosen = np.sort(rng.permutation(len(plan.walls) // 2)[:count])
        row = np.repeat(2 * chosen, 2) + np.tile([0, 1], len(chosen))
        pivot = plan.walls[row, :4].reshape(-1, 2, 2).mean(axis=1)
        heading = np.repeat(rng.uniform(0, 2 * np.pi, len(chosen)), 2)
        swing_rad = TURN_RAD
        slide_m = SLIDE_M * np.column_stack([np.cos(heading), np.sin(heading)])
    else:
        doors = _hung_doors(plan, count, rng)
        row = len(plan.walls) + np.arange(len(doors))
        pivot = np.repeat(doors[::2, :2], 2, axis=0)
        swing_rad, slide_m = SWING_RAD, np.zeros((len(doors), 2))
        heights = np.tile(plan.walls[0, 4:], (len(doors), 1))
        plan = replace(plan, walls=np.vstack([plan.walls, np.hstack([doors, heights])]))
    n = len(row) // 2
    period, phase = rng.uniform(*PERIOD, n), rng.uniform(0, 2 * np.pi, n)
    rhythm = np.repeat(period, 2), np.repeat(phase, 2)  # the same for both sides
    return plan, MovingWalls(row, pivot, swing_rad, slide_m, *rhythm)


def _hung_doors(plan: FloorPlan, count: int, rng: np.random.Generator) -> Floats:
    """Return both sides (2 d, 4) of half-open doors that touch neither walls nor each other."""
    leaves = [np.empty((0, 4))]
    hinges = np.empty((0, 2))
    for hinge, edge in plan.doors[rng.permutation(len(plan.doors))]:
        x, y = edge - hinge
        angle = OPEN_RAD + SWING_RAD * np.linspace(-1, 1, 9)
        c, s = np.cos(angle), np.sin(angle)
        swept = hinge + np.column_stack([c * x - s * y, s * x + c * y])
        free = wall_distances(swept, plan.walls).min() > CLEARANCE_M / 4
        apart = np.linalg.norm(hinges - hinge, axis=1).min(initial=np.inf) > 2 * DOOR_M[1]
        if len(hinges) < count and free and apart:
            tip = swept[len(swept) // 2]
            near = hinge + AJAR_M * (tip - hinge) / np.linalg.norm(tip - hinge)
            leaves.append(np.array([[*near, *tip], [*tip, *near]]))
            hinges = np.vstack([hinges, hinge])
    return np.vstack(leaves)
