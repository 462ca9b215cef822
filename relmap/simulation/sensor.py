"""Measurements of a range sensor on the visible stretches of walls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.shown import Brief
from relmap.simulation.noise import Noise, draw_noise
from relmap.simulation.visibility import SeenWalls, ray_distances

Sampling = Literal["surface", "rays", "laser"]
"""Sampling of points: uniform on the visible surface, or where equally spaced beams hit it (in
azimuth and elevation, or in the plane of the sensor)."""

Before = Callable[[Floats, Floats], Floats]
"""From bearings (b,) and ranges (b,) of beams to their distances (b,) from objects in front of the
walls; infinite if there is none."""

_SLACK_RAD = 1e-12


@dataclass(frozen=True)
class Sensor:
    """Field of view and range of a sensor.

    Attributes
    ----------
    range_m : float
        Horizontal range, metres.
    view_rad : float
        Horizontal field of view, radians, centred ahead; less than a full turn.
    vertical_view_rad : float
        Vertical field of view of `rays`, radians, centred at the horizon.
    """

    range_m: float = 8.0
    view_rad: float = np.deg2rad(90.0)
    vertical_view_rad: float = np.deg2rad(60.0)


DEPTH_SENSOR = Sensor()
LASER = Sensor(view_rad=np.deg2rad(180.0))


def sensor_of(
    sampling: Sampling, view_deg: float | None = None, range_m: float | None = None
) -> Sensor:
    """Return the default sensor of a sampling, with given values replaced."""
    usual = LASER if sampling == "laser" else DEPTH_SENSOR
    view_rad = usual.view_rad if view_deg is None else float(np.deg2rad(view_deg))
    return replace(usual, view_rad=view_rad, range_m=usual.range_m if range_m is None else range_m)


@dataclass(frozen=True, eq=False, repr=False)
class BuildingScan(Brief):
    """The measurements from one pose, and the truth.

    Attributes
    ----------
    points : (n, 3) float64, robot frame, metres
        For a laser with z = 0, from right to left.
    seen : SeenWalls
        The visible stretches of walls.
    stretch : (n,) int64
        The row of `seen` that each point belongs to; -1 for no wall, or for glass.
    ranges_m : (b,) float64 or None
        For a laser: the range of every beam, right to left; infinite without a return.
    """

    points: Floats
    seen: SeenWalls
    stretch: Ints
    ranges_m: Floats | None = None

    @property
    def wall(self) -> Ints:
        """The wall of each point, -1 for none; (n,)."""
        return np.append(self.seen.wall, -1)[self.stretch]


@dataclass(frozen=True)
class Scanner:
    """A sensor with noise and number of points; see `relmap.simulation.simulate_building`."""

    points: int
    sigma: float
    noise: Noise
    sampling: Sampling
    sensor: Sensor
    sample_ends: bool

    def scan(
        self,
        seen: SeenWalls,
        z_robot: Floats,
        rng: np.random.Generator,
        before: Before | None = None,
    ) -> BuildingScan:
        """Measure the visible stretches of walls.

        `z_robot` (2,), robot frame, metres: lower and upper edge of all walls; `before`: for a
        laser: objects in front of the walls.
        """
        if self.sampling == "surface":
            return self._scatter(seen, z_robot, rng)
        if self.sampling == "rays":
            return self._cast(seen, z_robot, rng)
        return self._sweep(seen, rng, before)

    def _scatter(self, seen: SeenWalls, z_robot: Floats, rng: np.random.Generator) -> BuildingScan:
        """Sample points uniformly on the visible surface, with noise in each coordinate."""
        across = seen.ends[:, 1] - seen.ends[:, 0]
        reach = np.cumsum(np.linalg.norm(across, axis=1))
        if not len(reach):
            return BuildingScan(np.empty((0, 3)), seen, np.empty(0, dtype=np.int64))
        stretch = np.searchsorted(reach, rng.uniform(0, reach[-1], self.points), side="right")
        t = rng.uniform(0, 1, self.points)
        if self.sample_ends:
            order = np.argsort(stretch, kind="stable")
            rank = np.arange(len(order)) - np.searchsorted(stretch[order], stretch[order])
            enough = np.bincount(stretch)[stretch[order]] >= 2
            t[order[enough & (rank == 0)]] = 0.0
            t[order[enough & (rank == 1)]] = 1.0
        flat = seen.ends[stretch, 0] + t[:, None] * across[stretch]
        # Exact at the left end, where rounding would matter.
        flat = np.where(t[:, None] == 1, seen.ends[stretch, 1], flat)
        points = np.column_stack([flat, rng.uniform(z_robot[0], z_robot[1], self.points)])
        return BuildingScan(points + self._errors(points, rng), seen, stretch)

    def _cast(self, seen: SeenWalls, z_robot: Floats, rng: np.random.Generator) -> BuildingScan:
        """Measure a grid of beams; those that pass above or below all walls return nothing.

        The points go from right to left, those of one azimuth upwards.
        """
        sensor = self.sensor
        columns = max(2, round(np.sqrt(self.points * sensor.view_rad / sensor.vertical_view_rad)))
        rows = max(1, round(self.points / columns))
        half = sensor.vertical_view_rad / 2
        elevation = np.linspace(-half, half, rows) if rows > 1 else np.zeros(1)
        bearing, stretch, distance = self._met(seen, columns)
        z = distance[:, None] * np.tan(elevation)
        column, row = np.nonzero((z >= z_robot[0]) & (z <= z_robot[1]) & (stretch[:, None] >= 0))
        ranges = self._measured(distance[column] / np.cos(elevation[row]), rng)
        flat = ranges * np.cos(elevation[row])
        z = ranges * np.sin(elevation[row])
        return BuildingScan(_points(flat, bearing[column], z), seen, stretch[column])

    def _sweep(
        self, seen: SeenWalls, rng: np.random.Generator, before: Before | None
    ) -> BuildingScan:
        """Measure beams in the plane of the sensor, equally spaced from right to left."""
        bearing, stretch, distance = self._met(seen, self.points)
        if before is not None:
            free_m = np.where(stretch >= 0, distance, self.sensor.range_m)
            before_m = before(bearing, free_m)
            hidden = before_m < free_m
            stretch = np.where(hidden, -1, stretch)
            distance = np.where(hidden, before_m, distance)
        met = distance > 0
        ranges = self._measured(distance, rng)
        points = _points(ranges[met], bearing[met], np.zeros(int(met.sum())))
        return BuildingScan(points, seen, stretch[met], np.where(met, ranges, np.inf))

    def _measured(self, ranges: Floats, rng: np.random.Generator) -> Floats:
        """Add noise to ranges; none is negative, which would be behind the sensor."""
        return np.abs(ranges + self._errors(ranges, rng))

    def _errors(self, of: Floats, rng: np.random.Generator) -> Floats:
        return draw_noise(self.noise, self.sigma, of.shape, rng)

    def _met(self, seen: SeenWalls, beams: int) -> tuple[Floats, Ints, Floats]:
        """Return bearing (b,), stretch, -1 for none, and distance at which each beam hits."""
        bearing = np.linspace(-self.sensor.view_rad / 2, self.sensor.view_rad / 2, beams)
        if not len(seen.wall):
            return bearing, np.full(beams, -1), np.zeros(beams)
        limits = np.arctan2(seen.ends[..., 1], seen.ends[..., 0])
        at = np.searchsorted(limits[:, 0], bearing + _SLACK_RAD, side="right") - 1
        met = (at >= 0) & (bearing <= limits[at, 1] + _SLACK_RAD)
        distance = ray_distances(seen.ends[at], bearing)
        return bearing, np.where(met, at, -1), np.where(met, distance, 0.0)


def _points(flat: Floats, bearing: Floats, z: Floats) -> Floats:
    return np.column_stack([flat * np.cos(bearing), flat * np.sin(bearing), z])
