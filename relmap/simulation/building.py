"""A robot that drives through a building, or among panels, and sees points of the walls.

The world is 2½-D: vertical walls of one height, a robot that moves in the plane. Its frame, which
is its sensor's, is `SENSOR_HEIGHT_M` above the floor; there the map's z is 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.simulation.drive import STEP_S, drive_round
from relmap.simulation.floor_plan import (
    CLEARANCE_M,
    FloorPlan,
    World,
    make_floor_plan,
    wall_distances,
)
from relmap.simulation.moving_walls import make_moving
from relmap.simulation.noise import Noise
from relmap.simulation.sensor import (
    DEPTH_SENSOR,
    LASER,
    Sample,
    Sampling,
    Sensor,
    cast_rays,
    sample_surface,
    scan_laser,
)
from relmap.simulation.visibility import SeenWalls, seen_walls

SENSOR_HEIGHT_M = 1.0


@dataclass(frozen=True, eq=False)
class BuildingScan:
    """What the robot saw at one place, and what it was.

    Attributes
    ----------
    points : (n, 3) float64, robot frame, metres
        Of a laser with z = 0, from right to left.
    wall : (n,) int64
        The wall that each point belongs to.
    seen : SeenWalls
        The visible stretches of walls.
    stretch : (n,) int64
        The row of `seen` that each point belongs to.
    ranges_m : (b,) float64 or None
        Of a laser: the range of every beam, right to left; infinite where there is no return.
    """

    points: NDArray[np.float64]
    wall: NDArray[np.int64]
    seen: SeenWalls
    stretch: NDArray[np.int64]
    ranges_m: NDArray[np.float64] | None = None


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


@dataclass(frozen=True)
class _Look:
    """How every scan is made; the fields are the arguments of `simulate_building`."""

    points: int
    sigma: float
    noise: Noise
    sampling: Sampling
    sensor: Sensor
    sample_ends: bool

    def validate(self) -> None:
        """Raise a RelmapError where a field is out of its range."""
        _require(
            (
                1 <= self.points <= 10**7,
                f"points is {self.points}; it must lie in [1, 10000000]",
            ),
            (0 <= self.sigma < 1e3, f"sigma is {self.sigma}; it must lie in [0, 1000) metres"),
            (
                self.noise in get_args(Noise),
                f"noise is {self.noise!r}; it must be gaussian or uniform",
            ),
            (
                self.sampling in get_args(Sampling),
                f"sampling is {self.sampling!r}; it must be surface, rays or laser",
            ),
            (
                0 < self.sensor.range_m < np.inf,
                f"the range of the sensor is {self.sensor.range_m}; it must be positive, metres",
            ),
            (
                0 < self.sensor.view_rad <= np.pi and 0 < self.sensor.vertical_view_rad < np.pi,
                "the field of view must lie in (0, pi] radians, the vertical one in (0, pi)",
            ),
        )

    def sample(
        self, seen: SeenWalls, z_robot: NDArray[np.float64], rng: np.random.Generator
    ) -> Sample:
        """Measure the visible stretches of walls."""
        count, noise, sigma = self.points, self.noise, self.sigma
        if self.sampling == "surface":
            return sample_surface(seen, z_robot, count, noise, sigma, rng, self.sample_ends)
        if self.sampling == "rays":
            return cast_rays(seen, z_robot, self.sensor, count, noise, sigma, rng)
        return scan_laser(seen, self.sensor, count, noise, sigma, rng)


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
        Hang so many doors that swing, or among panels let so many of them slide and turn.

    Raises
    ------
    RelmapError
        Where an argument is out of its range.
    """
    look = _Look(points, sigma, noise, sampling, sensor or _default_sensor(sampling), sample_ends)
    look.validate()
    _validate_run(iterations, seed, world, loops, moving)
    rng = np.random.default_rng(seed)
    plan = make_floor_plan(world, rng)
    trajectory = drive_round(plan.loop, loops, iterations, rng)
    # Movers have a generator of their own: the rest of the world is the same with and without them.
    plan, movers = make_moving(plan, world, moving, np.random.default_rng([seed, moving]))
    scans = [_scan(movers.at(plan.walls, k), pose, look, rng) for k, pose in enumerate(trajectory)]
    walls = movers.at(plan.walls, 0) - [0, 0, 0, 0, SENSOR_HEIGHT_M, SENSOR_HEIGHT_M]
    moves = np.isin(np.arange(len(walls)), movers.row)
    stamps_s = STEP_S * np.arange(len(trajectory), dtype=np.float64)
    return Building(walls, moves, trajectory, stamps_s, scans, look.sensor)


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

    The arguments are those of `simulate_building`.

    Raises
    ------
    RelmapError
        Where an argument is out of its range.
    """
    look = _Look(points, sigma, noise, sampling, sensor or _default_sensor(sampling), sample_ends)
    look.validate()
    _validate_run(None, seed, "building", 1, 0)
    rng = np.random.default_rng(seed)
    plan = make_floor_plan("building", rng)
    return _scan(plan.walls, _random_pose(plan, rng), look, rng)


def _default_sensor(sampling: str) -> Sensor:
    return LASER if sampling == "laser" else DEPTH_SENSOR


def _random_pose(plan: FloorPlan, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a pose (4, 4), uniform over the floor that is clear of walls."""
    low, high = plan.floors[:, :2] + CLEARANCE_M, plan.floors[:, 2:] - CLEARANCE_M
    share = np.prod(high - low, axis=1)
    while True:
        floor = rng.choice(len(share), p=share / share.sum())
        position = rng.uniform(low[floor], high[floor])
        if wall_distances(position[None], plan.walls).min() >= CLEARANCE_M:
            break
    yaw = rng.uniform(-np.pi, np.pi)
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:2, 3] = position
    return pose


def _scan(
    walls: NDArray[np.float64],
    T_map_robot: NDArray[np.float64],
    look: _Look,
    rng: np.random.Generator,
) -> BuildingScan:
    ends_map = walls[:, :4].reshape(-1, 2, 2)
    ends_robot = (ends_map - T_map_robot[:2, 3]) @ T_map_robot[:2, :2]
    seen = seen_walls(ends_robot, look.sensor.range_m, look.sensor.view_rad / 2)
    z_robot = walls[0, 4:] - SENSOR_HEIGHT_M
    sample = look.sample(seen, z_robot, rng)
    wall = seen.wall[sample.stretch]
    return BuildingScan(sample.points, wall, seen, sample.stretch, sample.ranges_m)


def _validate_run(iterations: int | None, seed: int, world: str, loops: int, moving: int) -> None:
    _require(
        (seed >= 0, f"seed is {seed}; it must not be negative"),
        (
            iterations is None or 1 <= iterations <= 10**6,
            f"iterations is {iterations}; it must lie in [1, 1000000]",
        ),
        (world in get_args(World), f"world is {world!r}; it must be building, panels or long-wall"),
        (1 <= loops <= 1000, f"loops is {loops}; it must lie in [1, 1000]"),
        (0 <= moving <= 1000, f"moving is {moving}; it must lie in [0, 1000]"),
    )


def _require(*limits: tuple[bool, str]) -> None:
    for holds, message in limits:
        if not holds:
            raise RelmapError(message)
