"""Objects in front of walls: walking people, clutter, and panes of glass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.simulation.drive import lengths_along, places_along
from relmap.simulation.sensor import Before
from relmap.simulation.shapes import FloorPlan, wall_distances
from relmap.simulation.visibility import ray_distances

BODY_M, WALK_M_S = (0.15, 0.25), (0.6, 1.4)
"""Radius and speed of a person."""
ASIDE_M, WITHIN_M, LANE_STEP_M = 0.6, 0.5, 0.2
"""Largest distance of people from the centre line of a corridor, and into rooms."""
TARGETS = 60
"""Number of places that a person visits."""
SHY_M, NEAREST_M = 0.5, 0.1
"""Distance that people and clutter keep from the robot."""
SPECULAR_RAD, MATT = np.deg2rad(12.0), 0.05
"""Obliqueness at which glass returns a beam, and fraction of others returned by dirt."""


@dataclass(frozen=True, eq=False)
class Things:
    """Objects that beams of a laser may hit in front of walls, in one scan.

    `people` (p, 3), map frame, metres: x, y and radius; `glass` (g,): walls that are panes;
    `clutter`: fraction of beams that hit small objects, such as leaves, cables or rain.
    """

    people: Floats
    glass: Ints
    clutter: float
    rng: np.random.Generator

    @property
    def any(self) -> bool:
        """Whether there are any objects."""
        return bool(len(self.people) or len(self.glass) or self.clutter)

    def seen_from(self, T_map_robot: Floats, walls_robot: Floats) -> Before:
        """Return a function for the ranges of beams; walls (w, 2, 2) are in the robot frame."""
        at = (self.people[:, :2] - T_map_robot[:2, 3]) @ T_map_robot[:2, :2]
        discs = np.column_stack([at, self.people[:, 2]])

        def before(bearing: Floats, ranges_m: Floats) -> Floats:
            panes = glass_ranges(walls_robot[self.glass], bearing, self.rng)
            solid_m = np.minimum(round_ranges(discs, bearing), panes)
            free_m = np.minimum(solid_m, ranges_m).clip(NEAREST_M)
            met = self.rng.uniform(size=len(bearing)) < self.clutter
            return np.minimum(solid_m, np.where(met, self.rng.uniform(NEAREST_M, free_m), np.inf))

        return before


def round_ranges(discs: Floats, bearing: Floats) -> Floats:
    """Return the distances of beams to discs.

    `discs` (d, 3), robot frame, metres: x, y of the centre, and the radius; the robot is outside.
    `bearing` (b,), radians. Returns (b,), metres: infinite if a beam hits none.
    """
    ray = np.stack([np.cos(bearing), np.sin(bearing)])
    along = discs[:, :2] @ ray
    left = along**2 - ((discs[:, :2] ** 2).sum(axis=1) - discs[:, 2] ** 2)[:, None]
    ahead = (left > 0) & (along > 0)
    ranges = np.where(ahead, along - np.sqrt(np.where(ahead, left, 0.0)), np.inf)
    return np.asarray(ranges.min(axis=0, initial=np.inf))


def glass_ranges(panes: Floats, bearing: Floats, rng: np.random.Generator) -> Floats:
    """Return the distances of beams to the panes that return them.

    `panes` (g, 2, 2), robot frame, metres: ends of both sides, right to left as seen from the
    front; `bearing` (b,), radians. Returns (b,), metres: infinite if a beam hits none, or passes
    through.
    """
    first, along = panes[:, None, 0], panes[:, None, 1] - panes[:, None, 0]
    ranges = ray_distances(panes[:, None], bearing)
    ray = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    at = ((ranges[..., None] * ray - first) * along).sum(axis=2) / (along**2).sum(axis=2)
    facing = panes[:, 0, 0] * panes[:, 1, 1] > panes[:, 0, 1] * panes[:, 1, 0]
    met = facing[:, None] & (ranges > 0) & (at >= 0) & (at <= 1)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    oblique = np.arccos(
        np.clip(np.abs((ray * normal).sum(axis=2)) / np.linalg.norm(normal, axis=2), 0, 1)
    )
    chance = np.where(oblique < SPECULAR_RAD, 1.0, MATT)
    returned = met & (rng.uniform(size=met.shape) < chance)
    return np.asarray(np.where(returned, ranges, np.inf).min(axis=0, initial=np.inf))


def walking(
    plan: FloorPlan, count: int, stamps_s: Floats, trajectory: Floats, rng: np.random.Generator
) -> Floats:
    """Simulate people who walk along the corridor, into rooms and out again.

    `count`: number of people. `stamps_s` (k,): time of each scan, seconds. `trajectory` (k, 4, 4):
    ``T_map_robot`` at each scan; people keep a distance from the robot. Returns (k, count, 3), map
    frame, metres: x, y and radius of each person at each scan.
    """
    people = np.empty((len(stamps_s), count, 3))
    for k in range(count):
        way, speed_m_s = _way(plan, rng), rng.uniform(*WALK_M_S)
        done_m = lengths_along(way)
        at_m = (rng.uniform(0, done_m[-1]) + speed_m_s * stamps_s) % done_m[-1]
        people[:, k, :2] = places_along(way, done_m, at_m)
        people[:, k, 2] = rng.uniform(*BODY_M)
    robot = trajectory[:, None, :2, 3]
    away = people[..., :2] - robot
    distance = np.linalg.norm(away, axis=2, keepdims=True)
    people[..., :2] = robot + away * np.maximum(1.0, SHY_M / np.maximum(distance, 1e-6))
    return people


def _way(plan: FloorPlan, rng: np.random.Generator) -> Floats:
    """Return the closed path (n, 2) of a person: along the corridor from door to door."""
    closed = np.vstack([plan.loop, plan.loop[:1]])
    length_m = lengths_along(closed)
    line = places_along(closed, length_m, np.arange(0, length_m[-1], LANE_STEP_M))
    ahead = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
    lane = line + rng.uniform(-ASIDE_M, ASIDE_M) * left
    free = wall_distances(lane, plan.walls).min(axis=1) > BODY_M[1]
    lane = np.where(free[:, None], lane, line)
    at = start = int(rng.integers(len(line)))
    parts = [lane[[at]]]
    for _ in range(TARGETS):
        goal, visit = int(rng.integers(len(line))), np.empty((0, 2))
        if len(plan.doors):
            right, left_jamb = plan.doors[rng.integers(len(plan.doors))]
            middle, across = (right + left_jamb) / 2, left_jamb - right
            inwards = np.array([-across[1], across[0]]) / np.linalg.norm(across)
            goal = int(np.linalg.norm(line - middle, axis=1).argmin())
            visit = middle + np.outer([0.0, WITHIN_M, 0.0], inwards)
        parts += [_along(lane, at, goal), visit]
        at = goal
    return np.vstack([*parts, _along(lane, at, start)])


def _along(line: Floats, at: int, goal: int) -> Floats:
    """Return the shorter path (n, 2) on a closed line from one of its points to another."""
    n = len(line)
    there = (goal - at) % n
    steps = np.arange(there + 1) if there <= n / 2 else -np.arange(n - there + 1)
    return np.asarray(line[(at + steps) % n])
