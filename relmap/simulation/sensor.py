"""What a range sensor measures of the stretches of wall it sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from relmap.simulation.noise import Noise, draw_noise
from relmap.simulation.visibility import SeenWalls

Sampling = Literal["surface", "rays", "laser"]
"""How the points lie: uniform on the visible surface, or where equally spaced beams meet it (in
azimuth and elevation, or in the plane of the sensor)."""

_SLACK_RAD = 1e-12


@dataclass(frozen=True)
class Sensor:
    """What a sensor can see.

    Attributes
    ----------
    range_m : float
        Horizontal range, metres.
    view_rad : float
        Horizontal field of view, radians, centred ahead; at most a half turn.
    vertical_view_rad : float
        Vertical field of view of `rays`, centred at the horizon.
    """

    range_m: float = 8.0
    view_rad: float = np.deg2rad(90.0)
    vertical_view_rad: float = np.deg2rad(60.0)


DEPTH_SENSOR = Sensor(range_m=8.0, view_rad=np.deg2rad(90.0))
LASER = Sensor(range_m=8.0, view_rad=np.deg2rad(180.0))


@dataclass(frozen=True, eq=False)
class Sample:
    """Measured points.

    Attributes
    ----------
    points : (n, 3) float64, robot frame, metres
    stretch : (n,) int64
        The seen stretch that each point lies on.
    ranges_m : (b,) float64 or None
        Of a laser: the range of every beam, right to left; infinite where nothing is met.
    """

    points: NDArray[np.float64]
    stretch: NDArray[np.int64]
    ranges_m: NDArray[np.float64] | None = None


def sample_surface(
    seen: SeenWalls,
    z_robot: NDArray[np.float64],
    count: int,
    noise: Noise,
    sigma: float,
    rng: np.random.Generator,
    sample_ends: bool = False,
) -> Sample:
    """Scatter points uniformly over the visible surface; each coordinate has the noise.

    Parameters
    ----------
    seen : SeenWalls
    z_robot : (2,) float64, robot frame, metres
        Lower and upper edge of all walls.
    count : int
        Number of points; there is none where no wall is seen.
    noise, sigma
        Distribution and standard deviation of the noise, metres.
    rng : numpy.random.Generator
    sample_ends : bool
        Put a point on each end of every stretch that has two points or more.
    """
    across = seen.ends[:, 1] - seen.ends[:, 0]
    reach = np.cumsum(np.linalg.norm(across, axis=1))
    if not len(reach):
        return Sample(np.empty((0, 3)), np.empty(0, dtype=np.int64))
    stretch = np.searchsorted(reach, rng.uniform(0, reach[-1], count), side="right")
    t = rng.uniform(0, 1, count)
    if sample_ends:
        _put_on_ends(stretch, t)
    flat = seen.ends[stretch, 0] + t[:, None] * across[stretch]
    # Exact where rounding would matter: on the left end.
    flat = np.where(t[:, None] == 1, seen.ends[stretch, 1], flat)
    points = np.column_stack([flat, rng.uniform(z_robot[0], z_robot[1], count)])
    return Sample(points + draw_noise(noise, sigma, points.shape, rng), stretch)


def cast_rays(
    seen: SeenWalls,
    z_robot: NDArray[np.float64],
    sensor: Sensor,
    count: int,
    noise: Noise,
    sigma: float,
    rng: np.random.Generator,
) -> Sample:
    """Measure about `count` beams, equally spaced in azimuth and elevation.

    The range of each has the noise. Beams that pass above or below all walls return nothing. The
    points go from right to left, those of one azimuth upwards.
    """
    columns = max(2, round(np.sqrt(count * sensor.view_rad / sensor.vertical_view_rad)))
    rows = max(1, round(count / columns))
    half = sensor.vertical_view_rad / 2
    elevation = np.linspace(-half, half, rows) if rows > 1 else np.zeros(1)
    bearing = _bearings(sensor, columns)
    stretch, distance = _meet(seen, bearing)
    z = distance[:, None] * np.tan(elevation)
    column, row = np.nonzero((z >= z_robot[0]) & (z <= z_robot[1]) & (stretch[:, None] >= 0))
    ranges = distance[column] / np.cos(elevation[row])
    ranges += draw_noise(noise, sigma, ranges.shape, rng)
    return Sample(_points(ranges, bearing[column], elevation[row]), stretch[column])


def scan_laser(
    seen: SeenWalls,
    sensor: Sensor,
    beams: int,
    noise: Noise,
    sigma: float,
    rng: np.random.Generator,
) -> Sample:
    """Measure beams in the sensor's own plane, equally spaced from right to left, with z = 0."""
    bearing = _bearings(sensor, beams)
    stretch, distance = _meet(seen, bearing)
    ranges = distance + draw_noise(noise, sigma, distance.shape, rng)
    met = stretch >= 0
    points = _points(ranges[met], bearing[met], np.zeros(int(met.sum())))
    return Sample(points, stretch[met], np.where(met, ranges, np.inf))


def _put_on_ends(stretch: NDArray[np.int64], t: NDArray[np.float64]) -> None:
    """Move the first point of each stretch to its right end, the second to its left."""
    order = np.argsort(stretch, kind="stable")
    rank = np.arange(len(order)) - np.searchsorted(stretch[order], stretch[order])
    enough = np.bincount(stretch)[stretch[order]] >= 2
    t[order[enough & (rank == 0)]] = 0.0
    t[order[enough & (rank == 1)]] = 1.0


def _bearings(sensor: Sensor, count: int) -> NDArray[np.float64]:
    return np.linspace(-sensor.view_rad / 2, sensor.view_rad / 2, count)


def _meet(
    seen: SeenWalls, bearing: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the stretch that each beam (b,) meets, -1 for none, and how far off, metres."""
    if not len(seen.wall):
        return np.full(len(bearing), -1), np.zeros(len(bearing))
    limits = np.arctan2(seen.ends[..., 1], seen.ends[..., 0])
    at = np.searchsorted(limits[:, 0], bearing + _SLACK_RAD, side="right") - 1
    met = (at >= 0) & (bearing <= limits[at, 1] + _SLACK_RAD)
    (x0, y0), (x1, y1) = seen.ends[at, 0].T, seen.ends[at, 1].T
    across = np.cos(bearing) * (y1 - y0) - np.sin(bearing) * (x1 - x0)
    distance = (x0 * y1 - y0 * x1) / np.where(met, across, 1.0)
    return np.where(met, at, -1), np.where(met, distance, 0.0)


def _points(
    ranges: NDArray[np.float64], bearing: NDArray[np.float64], elevation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points (n, 3) in the robot frame."""
    flat = ranges * np.cos(elevation)
    return np.column_stack(
        [flat * np.cos(bearing), flat * np.sin(bearing), ranges * np.sin(elevation)]
    )
