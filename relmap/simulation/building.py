"""Simulation of a robot that drives through a building and observes points of walls.

The world is 2½-D: vertical walls of one height, a robot that moves in the plane. Its frame, which
is its sensor's, is `SENSOR_HEIGHT_M` above the floor; there the map's z is 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.shown import Brief
from relmap.datasets.scans import planar_poses
from relmap.simulation.drive import STEP_M, drive_round
from relmap.simulation.floor_plan import World, make_floor_plan, make_moving
from relmap.simulation.noise import Noise, check_arguments
from relmap.simulation.sensor import BuildingScan, Sampling, Scanner, Sensor, sensor_of
from relmap.simulation.shapes import CLEARANCE_M, FloorPlan, wall_distances
from relmap.simulation.things import Things, walking
from relmap.simulation.visibility import seen_walls

SENSOR_HEIGHT_M = 1.0
STEP_S = 0.2
"""Interval between scans, in which the robot moves `STEP_M`."""
OFTEN, POINTS, CELL_M = 10, 5, 0.05
"""Number of scans, and of points in each, for a place of a wall to count as seen; and
resolution."""
STRAIGHT, CHORD_M, SAME_M = np.cos(np.deg2rad(5.0)), 0.2, 1e-6
"""Walls shorter than this that continue this straight (cosine) form no corner."""


@dataclass(frozen=True, eq=False, repr=False)
class Building(Brief):
    """A simulated run and its truth.

    Attributes
    ----------
    walls : (w, 6) float64, map frame, metres
        x0, y0, x1, y1, z0, z1; the two ends go from right to left as seen from the wall's front. A
        wall with two sides is two walls. Moving walls are given at their position in the first
        scan.
    moving : (w,) bool
    trajectory : (k, 4, 4) float64
        ``T_map_robot`` at each scan.
    stamps_s : (k,) float64
    scans : list of k BuildingScan
    sensor : Sensor
        The simulated sensor.
    """

    walls: Floats
    moving: Bools
    trajectory: Floats
    stamps_s: Floats
    scans: list[BuildingScan]
    sensor: Sensor

    def times_seen(self) -> Ints:
        """Count the scans that saw a part of each wall, its right end, and its left end; (w, 3).

        An end where the wall continues, as in a curve, does not count.
        """
        counts = np.zeros((len(self.walls), 3), dtype=np.int64)
        for scan in self.scans:
            corner = scan.seen.end_type == "corner"
            counts[np.unique(scan.seen.wall), 0] += 1
            # No two stretches of a wall share a true end.
            counts[scan.seen.wall[corner[:, 0]], 1] += 1
            counts[scan.seen.wall[corner[:, 1]], 2] += 1
        ends = self.walls[:, :4].reshape(-1, 2, 2)
        along = ends[:, 1] - ends[:, 0]
        length_m = np.linalg.norm(along, axis=1)
        along /= length_m[:, None]
        follows = np.linalg.norm(ends[:, None, 1] - ends[None, :, 0], axis=2) < SAME_M
        follows &= np.minimum(length_m[:, None], length_m) < CHORD_M
        follows &= along @ along.T > STRAIGHT
        counts[follows.any(axis=0), 1] = 0
        counts[follows.any(axis=1), 2] = 0
        return counts

    def seen_extents(self) -> Floats:
        """Return the extent (w, 2) of each wall that was seen in ten scans by five points each.

        Metres from its first end; NaN if it was not seen, or moves.
        """
        first, along = self.walls[:, :2], self.walls[:, 2:4] - self.walls[:, :2]
        length_m = np.linalg.norm(along, axis=1)
        covered = [np.zeros(int(np.ceil(length / CELL_M)) + 1, np.int64) for length in length_m]
        for pose, scan in zip(self.trajectory, self.scans, strict=True):
            wall = scan.wall
            at = scan.points[:, :2] @ pose[:2, :2].T + pose[:2, 3] - first[wall]
            t_m = np.clip((at * along[wall]).sum(axis=1) / length_m[wall], 0.0, length_m[wall])
            for k in np.flatnonzero(np.bincount(wall[wall >= 0]) >= POINTS).tolist():
                own = t_m[wall == k]
                covered[k][round(own.min() / CELL_M) : round(own.max() / CELL_M) + 1] += 1
        extents = np.full((len(self.walls), 2), np.nan)
        for k, count in enumerate(covered):
            often = np.flatnonzero(count >= OFTEN)
            if len(often) and not self.moving[k]:
                extents[k] = np.minimum(often[[0, -1]] * CELL_M, length_m[k])
        return extents


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
    step_m: float = STEP_M,
    people: int = 0,
    clutter: float = 0.0,
) -> Building:
    """Drive round the corridor of a building, or round among panels.

    Parameters
    ----------
    points, sigma, noise, sampling, sensor, sample_ends
        As for `building_scene`.
    iterations : int, optional
        Number of scans; by default as many as the loops take. One loop is 250 to 310 in a building,
        some 200 among panels, 390 along the long wall and back, with the usual step.
    seed : int
        Seed of everything random.
    world : str
        One of `relmap.simulation.floor_plan.World`.
    loops : int
        Number of rounds.
    moving : int
        Number of swinging doors; among panels, of panels that slide and turn.
    step_m : float
        Distance between scans; rotations scale with it, with at most 4 degrees at 0.22 m.
    people : int
        Number of walking people; only for a laser.
    clutter : float
        Fraction of the beams of a laser that hit small objects, different in each scan.

    Returns
    -------
    Building

    Raises
    ------
    RelmapError
        If an argument is out of its range.
    """
    sensor = sensor or sensor_of(sampling)
    scanner = Scanner(points, sigma, noise, sampling, sensor, sample_ends)
    some, worlds = iterations is None or 1 <= iterations <= 10**6, get_args(World)
    fits = sampling == "laser" or not (people or clutter or world == "glass")
    _check(
        scanner,
        seed,
        (some, f"iterations is {iterations}; it must lie in [1, 1000000]"),
        (world in worlds, f"world is {world!r}; it must be one of {', '.join(worlds)}"),
        (1 <= loops <= 1000, f"loops is {loops}; it must lie in [1, 1000]"),
        (0 <= moving <= 1000, f"moving is {moving}; it must lie in [0, 1000]"),
        (0 < step_m <= 10, f"step is {step_m}; it must lie in (0, 10] metres"),
        (0 <= people <= 1000, f"people is {people}; it must lie in [0, 1000]"),
        (0 <= clutter <= 0.5, f"clutter is {clutter}; it must lie in [0, 0.5]"),
        (fits, "people, clutter and glass are only for lasers; sampling must be laser"),
    )
    rng = np.random.default_rng(seed)
    plan = make_floor_plan(world, rng)
    trajectory = drive_round(plan.loop, loops, iterations, step_m, rng)
    stamps_s = STEP_S * (step_m / STEP_M) * np.arange(len(trajectory), dtype=np.float64)
    # Moving walls and objects have separate generators, so the rest is unchanged.
    walkers, others = (np.random.default_rng([seed, people, which]) for which in (1, 2))
    crowd = walking(plan, people, stamps_s, trajectory, walkers)
    plan, movers = make_moving(plan, world, moving, np.random.default_rng([seed, moving]))
    scans = [
        _scan(movers.at(plan.walls, k), pose, scanner, rng, Things(at, plan.glass, clutter, others))
        for k, (pose, at) in enumerate(zip(trajectory, crowd, strict=True))
    ]
    walls = movers.at(plan.walls, 0) - [0, 0, 0, 0, SENSOR_HEIGHT_M, SENSOR_HEIGHT_M]
    moves = np.isin(np.arange(len(walls)), movers.row)
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
    """Simulate one scan from a random pose in a random building, corridor or room.

    Parameters
    ----------
    seed : int
        Seed of everything random.
    points : int
        Points of a scan; with `rays` and `laser` the number of beams, some of which return no
        point.
    sigma : float
        Standard deviation, metres: of each coordinate with `surface`, of the range otherwise.
    noise : "gaussian" or "uniform"
        Distribution of the noise; both have the standard deviation `sigma`.
    sampling : "surface", "rays" or "laser"
        Points uniform on the visible surface, a grid of beams, or a 2-D laser scan.
    sensor : Sensor, optional
        Range and field of view: 8 m and 90 degrees (`laser`: 180) if omitted.
    sample_ends : bool
        With `surface`, put a point on each end of every stretch that has two points or more.

    Returns
    -------
    BuildingScan

    Raises
    ------
    RelmapError
        If an argument is out of its range.
    """
    sensor = sensor or sensor_of(sampling)
    scanner = Scanner(points, sigma, noise, sampling, sensor, sample_ends)
    _check(scanner, seed)
    rng = np.random.default_rng(seed)
    plan = make_floor_plan("building", rng)
    return _scan(plan.walls, _random_pose(plan, rng), scanner, rng)


def _check(scanner: Scanner, seed: int, *limits: tuple[bool, str]) -> None:
    """Raise an error for a scanner out of range, and as `check_arguments` does."""
    points, sampling, sensor = scanner.points, scanner.sampling, scanner.sensor
    reach, sampled = sensor.range_m, sampling in get_args(Sampling)
    seen = 0 < sensor.view_rad < 2 * np.pi and 0 < sensor.vertical_view_rad < np.pi
    of_scanner = (
        (1 <= points <= 10**7, f"points is {points}; it must lie in [1, 10000000]"),
        (sampled, f"sampling is {sampling!r}; it must be surface, rays or laser"),
        (0 < reach < np.inf, f"the range of the sensor is {reach}; it must be positive, metres"),
        (seen, "the field of view must lie in (0, 2 pi) radians, the vertical one in (0, pi)"),
    )
    check_arguments(scanner.noise, scanner.sigma, seed, *of_scanner, *limits)


def _random_pose(plan: FloorPlan, rng: np.random.Generator) -> Floats:
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
    walls: Floats,
    T_map_robot: Floats,
    scanner: Scanner,
    rng: np.random.Generator,
    things: Things | None = None,
) -> BuildingScan:
    sensor, before = scanner.sensor, None
    ends_map = walls[:, :4].reshape(-1, 2, 2)
    ends_robot = (ends_map - T_map_robot[:2, 3]) @ T_map_robot[:2, :2]
    opaque = np.arange(len(walls))
    if things is not None and things.any:
        before, opaque = things.seen_from(T_map_robot, ends_robot), np.delete(opaque, things.glass)
    seen = seen_walls(ends_robot[opaque], sensor.range_m, sensor.view_rad / 2)
    seen = replace(seen, wall=opaque[seen.wall])
    return scanner.scan(seen, walls[0, 4:] - SENSOR_HEIGHT_M, rng, before)
