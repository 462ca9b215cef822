"""Walls that move: doors that swing into their rooms, and panels that slide to and fro and turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.simulation.floor_plan import CLEARANCE_M, DOOR_M, FloorPlan, World, wall_distances

OPEN_RAD = np.deg2rad(65.0)
SWING_RAD = np.deg2rad(40.0)
"""A door swings about half open, so far either way."""
SLIDE_M = 0.22
TURN_RAD = np.deg2rad(12.0)
"""A panel goes and turns so far either way, and keeps clear of the others."""
PERIOD = (30.0, 60.0)
"""Scans in which it comes back."""
AJAR_M = 0.02
"""A door's leaf begins so far from the wall."""


@dataclass(frozen=True, eq=False)
class MovingWalls:
    """Walls that turn about a pivot and slide, as a sine of the scan's number; r walls.

    Attributes
    ----------
    row : (r,) int64
        Which walls of the plan they are.
    pivot : (r, 2) float64, metres
    swing_rad : (r,) float64
    slide_m : (r, 2) float64
        How far they turn and slide either way.
    period, phase : (r,) float64
        Scans, and radians.
    """

    row: NDArray[np.int64]
    pivot: NDArray[np.float64]
    swing_rad: NDArray[np.float64]
    slide_m: NDArray[np.float64]
    period: NDArray[np.float64]
    phase: NDArray[np.float64]

    def at(self, walls: NDArray[np.float64], iteration: int) -> NDArray[np.float64]:
        """Return the walls (w, 6) as they are in one scan."""
        if not len(self.row):
            return walls
        share = np.sin(2 * np.pi * iteration / self.period + self.phase)
        angle = share * self.swing_rad
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        off = walls[self.row, :4].reshape(-1, 2, 2) - self.pivot[:, None]
        turned = np.stack([c * off[..., 0] - s * off[..., 1], s * off[..., 0] + c * off[..., 1]], 2)
        moved = walls.copy()
        there = turned + (self.pivot + share[:, None] * self.slide_m)[:, None]
        moved[self.row, :4] = there.reshape(-1, 4)
        return moved


def make_moving(
    plan: FloorPlan, world: World, count: int, rng: np.random.Generator
) -> tuple[FloorPlan, MovingWalls]:
    """Let some walls move: hang so many doors in a building, or let so many panels slide.

    Fewer where fewer doors are free to swing, or fewer panels stand there.
    """
    if world == "panels":
        return plan, _sliding_panels(plan, count, rng)
    return _with_doors(plan, count, rng)


def _sliding_panels(plan: FloorPlan, count: int, rng: np.random.Generator) -> MovingWalls:
    n = len(plan.walls) // 2
    chosen = np.sort(rng.permutation(n)[:count])
    row = np.repeat(2 * chosen, 2) + np.tile([0, 1], len(chosen))
    middle = plan.walls[row, :4].reshape(-1, 2, 2).mean(axis=1)
    heading = np.repeat(rng.uniform(0, 2 * np.pi, len(chosen)), 2)
    slide_m = SLIDE_M * np.column_stack([np.cos(heading), np.sin(heading)])
    swing_rad = np.full(len(row), TURN_RAD)
    return MovingWalls(row, middle, swing_rad, slide_m, *_rhythm(len(chosen), rng))


def _with_doors(
    plan: FloorPlan, count: int, rng: np.random.Generator
) -> tuple[FloorPlan, MovingWalls]:
    leaves: list[list[list[float]]] = []
    hinges = np.empty((0, 2))
    for hinge, edge in plan.doors[rng.permutation(len(plan.doors))]:
        along = edge - hinge
        swept = [
            hinge + _turned(along, angle)
            for angle in (OPEN_RAD, *OPEN_RAD + SWING_RAD * np.linspace(-1, 1, 9))
        ]
        # Only doors are hung that hit neither walls nor one another.
        free = wall_distances(np.array(swept), plan.walls).min() > CLEARANCE_M / 4
        apart = np.linalg.norm(hinges - hinge, axis=1).min(initial=np.inf) > 2 * DOOR_M[1]
        if len(leaves) < count and free and apart:
            tip = swept[0]
            near = hinge + AJAR_M * (tip - hinge) / np.linalg.norm(tip - hinge)
            leaves.append([[*near, *tip], [*tip, *near]])
            hinges = np.vstack([hinges, hinge])
    if not leaves:
        return plan, _sliding_panels(plan, 0, rng)
    flat = np.array(leaves).reshape(-1, 4)
    heights = np.tile(plan.walls[0, 4:], (len(flat), 1))
    walls = np.vstack([plan.walls, np.hstack([flat, heights])])
    row = len(plan.walls) + np.arange(len(flat))
    pivot = np.repeat(flat[::2, :2], 2, axis=0)
    swing_rad, slide_m = np.full(len(flat), SWING_RAD), np.zeros((len(flat), 2))
    moving = MovingWalls(row, pivot, swing_rad, slide_m, *_rhythm(len(leaves), rng))
    return FloorPlan(walls, plan.floors, plan.loop, plan.doors), moving


def _rhythm(
    count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return periods and phases, the same for both sides."""
    period, phase = rng.uniform(*PERIOD, count), rng.uniform(0, 2 * np.pi, count)
    return np.repeat(period, 2), np.repeat(phase, 2)


def _turned(v: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])
