"""What stands before the walls and is none: people who walk about, clutter, and panes of glass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from relmap.simulation.noise import Array
from relmap.simulation.shapes import FloorPlan
from relmap.simulation.visibility import ray_distances

LEG_M, APART_M, STRIDE_M = 0.07, 0.12, 0.2
"""Radius of a leg, its distance to the side, and how far it swings to the front and back."""
WALK_M_S = (0.6, 1.4)
LANE_STEP_M = 0.2
ASIDE_M, WITHIN_M = 0.6, 1.3
"""People walk so far beside the middle of a corridor at most, and so far into rooms."""
TARGETS = 60
"""Places that a person goes to, one after another."""
SHY_M = 0.5
"""People keep this distance from the robot."""
THING_M = (0.01, 0.06)
"""Radius of things that lie about, in the least and the greatest; so far from the way at least:"""
FREE_M = 0.35
BATCH, VIEWS = 10, 40
"""So many things are added at a time until they fill their share of the beams of so many scans."""
SPECULAR_RAD, MATT = np.deg2rad(12.0), 0.05
"""How oblique a beam that glass returns is, and the share of others that its dirt returns."""

Look = Callable[[Array], Array]
"""Gives the ranges (b,) of the beams at a pose (4, 4); infinite where nothing returns them."""


def round_ranges(discs: Array, bearing: Array) -> Array:
    """Return how far beams go to round things.

    Parameters
    ----------
    discs : (d, 3) float64, robot frame, metres
        x, y of the centre, and the radius; the robot is outside.
    bearing : (b,) float64, radians

    Returns
    -------
    (b,) float64, metres
        Infinite where a beam meets none.
    """
    ray = np.stack([np.cos(bearing), np.sin(bearing)])
    along = discs[:, :2] @ ray
    left = along**2 - ((discs[:, :2] ** 2).sum(axis=1) - discs[:, 2] ** 2)[:, None]
    ahead = (left > 0) & (along > 0)
    ranges = np.where(ahead, along - np.sqrt(np.where(ahead, left, 0.0)), np.inf)
    return np.asarray(ranges.min(axis=0, initial=np.inf))


def glass_ranges(panes: Array, bearing: Array, rng: np.random.Generator) -> Array:
    """Return how far beams go to the panes that return them.

    Parameters
    ----------
    panes : (g, 2, 2) float64, robot frame, metres
        Ends of both sides, right to left as seen from the front.
    bearing : (b,) float64, radians
    rng : numpy.random.Generator

    Returns
    -------
    (b,) float64, metres
        Infinite where a beam meets none, or passes through.
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


def strew(
    share: float, trajectory: Array, bearing: Array, look: Look, rng: np.random.Generator
) -> Array:
    """Strew small round things about until they fill a share of the beams.

    Parameters
    ----------
    share : float
        Of the beams that the walls return.
    trajectory : (k, 4, 4) float64
    bearing : (b,) float64, radians
    look : callable
        What a robot sees of the walls.
    rng : numpy.random.Generator

    Returns
    -------
    (d, 3) float64, map frame, metres
        x, y and radius.
    """
    views = trajectory[:: max(len(trajectory) // VIEWS, 1)]
    ranges = np.array([look(pose) for pose in views])
    discs, there = np.empty((0, 3)), np.isfinite(ranges)
    nearest = np.full(ranges.shape, np.inf)
    while (nearest < ranges).sum() < share * there.sum():
        new = np.array([_thing(trajectory, bearing, look, rng) for _ in range(BATCH)])
        way = np.linalg.norm(new[:, None, :2] - trajectory[:, :2, 3], axis=2).min(axis=1)
        new = new[way > FREE_M]
        for k, pose in enumerate(views):
            nearest[k] = np.minimum(nearest[k], round_ranges(in_robot_frame(new, pose), bearing))
        discs = np.vstack([discs, new])
    return discs


def _thing(trajectory: Array, bearing: Array, look: Look, rng: np.random.Generator) -> Array:
    """Return x, y and radius of a thing somewhere before a wall, as seen on the way."""
    pose, beam = trajectory[rng.integers(len(trajectory))], rng.integers(len(bearing))
    range_m = look(pose)[beam]
    far = rng.uniform(0, range_m) if np.isfinite(range_m) else 0.0
    ray = far * np.array([np.cos(bearing[beam]), np.sin(bearing[beam])])
    return np.append(pose[:2, :2] @ ray + pose[:2, 3], rng.uniform(*THING_M))


def in_robot_frame(discs: Array, T_map_robot: Array) -> Array:
    """Return round things (d, 3) of the map frame as the robot sees them."""
    at = (discs[:, :2] - T_map_robot[:2, 3]) @ T_map_robot[:2, :2]
    return np.column_stack([at, discs[:, 2]])


def walking(
    plan: FloorPlan, count: int, stamps_s: Array, trajectory: Array, rng: np.random.Generator
) -> Array:
    """Let people walk along the corridor, into rooms and out again.

    Returns
    -------
    (k, 2 count, 3) float64, map frame, metres
        x, y and radius of all legs at each scan.
    """
    legs = [leg for _ in range(count) for leg in _legs(plan, stamps_s, rng)]
    at = np.array(legs).reshape(-1, len(stamps_s), 2).swapaxes(0, 1)
    robot = trajectory[:, None, :2, 3]
    away = at - robot
    distance = np.linalg.norm(away, axis=2, keepdims=True)
    at = robot + away * np.maximum(1.0, SHY_M / np.maximum(distance, 1e-6))
    return np.concatenate([at, np.full((*at.shape[:2], 1), LEG_M)], axis=2)


def _legs(plan: FloorPlan, stamps_s: Array, rng: np.random.Generator) -> list[Array]:
    """Return where both legs of a person are (k, 2)."""
    way = _way(plan, rng)
    done_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    walked_m = rng.uniform(0, done_m[-1]) + rng.uniform(*WALK_M_S) * stamps_s
    middle, next_ = (
        np.column_stack([np.interp((walked_m + d) % done_m[-1], done_m, axis) for axis in way.T])
        for d in (0.0, STRIDE_M)
    )
    ahead = (next_ - middle) / STRIDE_M
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    swing = STRIDE_M * np.sin(walked_m * np.pi / (2 * STRIDE_M))[:, None]
    return [middle + side * (APART_M * left + swing * ahead) for side in (-1, 1)]


def _way(plan: FloorPlan, rng: np.random.Generator) -> Array:
    """Return the closed way (n, 2) of a person: along the corridor from door to door."""
    line = _dense(plan.loop)
    ahead = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
    lane = line + rng.uniform(-ASIDE_M, ASIDE_M) * left
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


def _dense(loop: Array) -> Array:
    """Return points of a closed line some `LANE_STEP_M` apart."""
    closed = np.vstack([loop, loop[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(0, length[-1], LANE_STEP_M)
    return np.column_stack([np.interp(at, length, axis) for axis in closed.T])


def _along(line: Array, at: int, goal: int) -> Array:
    """Return the shorter way (n, 2) on a closed line from one of its points to another."""
    n = len(line)
    there = (goal - at) % n
    steps = np.arange(there + 1) if there <= n / 2 else -np.arange(n - there + 1)
    return np.asarray(line[(at + steps) % n])
