"""A robot that drives through a building, or among panels, and sees points of the walls.

The world is 2½-D: vertical walls of one height, a robot that moves in the plane. Its frame, which
is its sensor's, is `SENSOR_HEIGHT_M` above the floor; there the map's z is 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from relmap.datasets.scans import planar_poses
from relmap.simulation.floor_plan import (
    CLEARANCE_M,
    FloorPlan,
    World,
    make_floor_plan,
    wall_distances,
)
from relmap.simulation.moving_walls import make_moving
from relmap.simulation.noise import Array, Noise, check_arguments
from relmap.simulation.sensor import DEPTH_SENSOR, LASER, BuildingScan, Sampling, Scanner, Sensor
from relmap.simulation.visibility import seen_walls

SENSOR_HEIGHT_M = 1.0
STEP_M = 0.22
TURN_RAD = np.deg2rad(4.0)
"""From one scan to the next the robot moves and turns by about this much, at most."""
WEAVE_M = 0.15
"""Amplitude with which it weaves about its line."""
WEAVES = 5
GRID_M = 0.01
SMOOTH_M = 0.4
STEP_S = 0.2


@dataclass(frozen=True, eq=False)
class Building:
    """A simulated run and its truth.

    Attributes
    ----------
    walls : (w, 6) float64, map frame, metres
        x0, y0, x1, y1, z0, z1; the two ends go from right to left as seen from the wall's front.
        A wall with two sides is two walls. Those that move are where they are in the first scan.
    moving : (w,) bool
    trajectory : (k, 4, 4) float64
        ``T_map_robot`` at each scan.
    stamps_s : (k,) float64
    scans : list of k BuildingScan
    sensor : Sensor
        What made them.
    """

    walls: NDArray[np.float64]
    moving: NDArray[np.bool_]
    trajectory: NDArray[np.float64]
    stamps_s: NDArray[np.float64]
    scans: list[BuildingScan]
    sensor: Sensor

    def times_seen(self) -> NDArray[np.int64]:
        """Count in how many scans each wall was seen.

        Returns
        -------
        (w, 3) int64
            Scans in which some of the wall was seen, its right end, and its left end.
        """
        counts = np.zeros((len(self.walls), 3), dtype=np.int64)
        for scan in self.scans:
            corner = scan.seen.end_type == "corner"
            counts[np.unique(scan.seen.wall), 0] += 1
            # No two stretches of a wall have the same true end.
            counts[scan.seen.wall[corner[:, 0]], 1] += 1
            counts[scan.seen.wall[corner[:, 1]], 2] += 1
        return counts


def simulate_building(
    points: int = 2000,
    sigma: float = 0.05,
    noise: Noise = "gaussian",
    sampling: Sampling = "surface",
    iterations: int | None = None,
    seed: int = 0,
    world: World = "building",
    loops: int = 1,
    *,
    sensor: Sensor | None = None,
    sample_ends: bool = False,
    moving: int = 0,
) -> Building:
    """Drive round the corridor of a building, or round among panels.

    Parameters
    ----------
    points : int
        Points of a scan; with `rays` and `laser` the number of beams, of which some return none.
    sigma : float
        Standard deviation, metres: of each coordinate with `surface`, of the range otherwise.
    noise : "gaussian" or "uniform"
        Distribution of the noise; both have the standard deviation `sigma`.
    sampling : "surface", "rays" or "laser"
        Points uniform on the visible surface, a grid of beams, or a 2-D laser scan.
    iterations : int, optional
        Number of scans; as many as the loops take where left out. One loop is 250 to 310 in a
        building, some 200 among panels, 390 along the long wall and back.
    seed : int
        Seed of everything random.
    world : "building", "panels" or "long-wall"
        Corridors and rooms, free-standing panels only, or a long wall alone, then panels.
    loops : int
        How often the robot drives round.
    sensor : Sensor, optional
        Range and field of view: 8 m and 90 degrees (`laser`: 180) where left out.
    sample_ends : bool
        With `surface`, put a point on each end of every stretch that has two points or more.
    moving : int
        Number of doors that swing; among panels, of panels that slide and turn.

    Returns
    -------
    Building

    Raises
    ------
    RelmapError
        Where an argument is out of its range.
    """
    sensor = sensor or (LASER if sampling == "laser" else DEPTH_SENSOR)
    scanner = Scanner(points, sigma, noise, sampling, sensor, sample_ends)
    _check(scanner, seed, iterations, world, loops, moving)
    rng = np.random.default_rng(seed)
    plan = make_floor_plan(world, rng)
    trajectory = _drive_round(plan.loop, loops, iterations, rng)
    # Movers have a generator of their own: the rest of the world is the same with and without them.
    plan, movers = make_moving(plan, world, moving, np.random.default_rng([seed, moving]))
    scans = [
        _scan(movers.at(plan.walls, k), pose, scanner, rng) for k, pose in enumerate(trajectory)
    ]
    walls = movers.at(plan.walls, 0) - [0, 0, 0, 0, SENSOR_HEIGHT_M, SENSOR_HEIGHT_M]
    moves = np.isin(np.arange(len(walls)), movers.row)
    stamps_s = STEP_S * np.arange(len(trajectory), dtype=np.float64)
    return Building(walls, moves, trajectory, stamps_s, scans, sensor)


def building_scene(
    seed: int,
    points: int = 2000,
    sigma: float = 0.05,
    noise: Noise = "gaussian",
    sampling: Sampling = "surface",
    *,
    sensor: Sensor | None = None,
    sample_ends: bool = False,
) -> BuildingScan:
    """Look once from a random pose in a random building, corridor or room.

    Parameters
    ----------
    seed, points, sigma, noise, sampling, sensor, sample_ends
        As `simulate_building` takes them.

    Returns
    -------
    BuildingScan

    Raises
    ------
    RelmapError
        Where an argument is out of its range.
    """
    sensor = sensor or (LASER if sampling == "laser" else DEPTH_SENSOR)
    scanner = Scanner(points, sigma, noise, sampling, sensor, sample_ends)
    _check(scanner, seed)
    rng = np.random.default_rng(seed)
    plan = make_floor_plan("building", rng)
    return _scan(plan.walls, _random_pose(plan, rng), scanner, rng)


def _check(
    scanner: Scanner,
    seed: int,
    iterations: int | None = None,
    world: str = "building",
    loops: int = 1,
    moving: int = 0,
) -> None:
    points, sampling, sensor = scanner.points, scanner.sampling, scanner.sensor
    range_m, view_rad = sensor.range_m, sensor.view_rad
    limits = [
        (1 <= points <= 10**7, f"points is {points}; it must lie in [1, 10000000]"),
        (
            sampling in get_args(Sampling),
            f"sampling is {sampling!r}; it must be surface, rays or laser",
        ),
        (
            0 < range_m < np.inf,
            f"the range of the sensor is {range_m}; it must be positive, metres",
        ),
        (
            0 < view_rad <= np.pi and 0 < sensor.vertical_view_rad < np.pi,
            "the field of view must lie in (0, pi] radians, the vertical one in (0, pi)",
        ),
        (
            iterations is None or 1 <= iterations <= 10**6,
            f"iterations is {iterations}; it must lie in [1, 1000000]",
        ),
        (world in get_args(World), f"world is {world!r}; it must be building, panels or long-wall"),
        (1 <= loops <= 1000, f"loops is {loops}; it must lie in [1, 1000]"),
        (0 <= moving <= 1000, f"moving is {moving}; it must lie in [0, 1000]"),
    ]
    check_arguments(scanner.noise, scanner.sigma, seed, *limits)


def _random_pose(plan: FloorPlan, rng: np.random.Generator) -> Array:
    """Draw a pose (4, 4), uniform over the floor that is clear of walls."""
    low, high = plan.floors[:, :2] + CLEARANCE_M, plan.floors[:, 2:] - CLEARANCE_M
    share = np.prod(high - low, axis=1)
    while True:
        floor = rng.choice(len(share), p=share / share.sum())
        position = rng.uniform(low[floor], high[floor])
        if wall_distances(position[None], plan.walls).min() >= CLEARANCE_M:
            break
    yaw = rng.uniform(-np.pi, np.pi)
    return np.asarray(planar_poses(position[:1], position[1:], np.array([yaw]))[0])


def _scan(
    walls: Array, T_map_robot: Array, scanner: Scanner, rng: np.random.Generator
) -> BuildingScan:
    ends_map = walls[:, :4].reshape(-1, 2, 2)
    ends_robot = (ends_map - T_map_robot[:2, 3]) @ T_map_robot[:2, :2]
    seen = seen_walls(ends_robot, scanner.sensor.range_m, scanner.sensor.view_rad / 2)
    return scanner.scan(seen, walls[0, 4:] - SENSOR_HEIGHT_M, rng)


def _drive_round(
    loop: Array, loops: int, iterations: int | None, rng: np.random.Generator
) -> Array:
    """Return the poses (k, 4, 4) of a robot on a closed line (l, 2), slower where it turns.

    It starts somewhere on the line; without a number of iterations it drives round `loops` times.
    """
    line, yaw, turning = _fine_line(loop, rng)
    effort = np.maximum(1 / STEP_M, turning / TURN_RAD)
    effort = gaussian_filter1d(effort, SMOOTH_M / GRID_M, mode="wrap")
    done = np.concatenate([[0.0], np.cumsum(effort)])
    around = int(np.ceil(done[-1] * GRID_M))
    k = loops * around if iterations is None else iterations
    at = np.arange(k) % around * (done[-1] / around)
    grid = np.arange(len(line), dtype=np.float64)
    cell = np.interp(at, done, grid)
    x, y, angle = (np.interp(cell, grid, values) for values in (*line.T, yaw))
    return planar_poses(x, y, angle)


def _fine_line(loop: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return points (g + 1, 2), yaw (g + 1,) and turn per metre (g,) of the way, g cells long."""
    closed = np.vstack([loop, loop[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    g = round(length[-1] / GRID_M)
    s = np.arange(g) * (length[-1] / g) + rng.uniform(0, length[-1])
    points = np.column_stack([np.interp(s % length[-1], length, axis) for axis in closed.T])
    points = gaussian_filter1d(points, SMOOTH_M / GRID_M / 2, axis=0, mode="wrap")
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    left /= np.linalg.norm(left, axis=1)[:, None]
    weave = WEAVE_M * np.sin(2 * np.pi * WEAVES * np.arange(g) / g + rng.uniform(0, 2 * np.pi))
    points += weave[:, None] * left
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    yaw = np.append(yaw, yaw[0] + 2 * np.pi)
    turning = np.abs(np.diff(yaw)) / GRID_M
    return np.vstack([points, points[:1]]), yaw, turning
