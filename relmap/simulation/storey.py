"""A sensor carried through rooms in space, of one storey or two, with exact truth.

Rays of the sensor end at the first face they hit; the noise is along the ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.shown import Brief
from relmap.datasets.scans import poses_of
from relmap.simulation.drive import lengths_along, places_along
from relmap.simulation.house import House, house, moving_box
from relmap.simulation.noise import check_arguments

Sensor = Literal["lidar", "depth"]
RINGS, BEAMS, HIGHEST_RAD, LOWEST_RAD = 32, 300, np.deg2rad(40.0), np.deg2rad(-40.0)
"""Rings of the lidar, beams per ring, and elevations of the outermost rings."""
ROWS, COLUMNS, FOCAL = 120, 160, 104.0
"""Of the depth camera: pixels, and its focal length in pixels."""
FARTHEST_M = 30.0
SQUARE_M = 0.1
"""Size of the squares in which the area that was seen is counted."""
MOVED_M = 0.1, 0.3
"""Least and largest way of a moving box from scan to scan."""
SWAY_M, SMOOTH_M = 4.0, 0.3
"""The sensor of a house sways once in the first distance; its path is rounded over the second."""


@dataclass(frozen=True, eq=False, repr=False)
class Storey(Brief):
    """A simulated run.

    Attributes
    ----------
    scans : list of (n, 3) float64, sensor frame, metres
    faces : list of (n,) int64
        The face of each point; -1 on a moving box.
    plane_of : (f,) int64
        The plane of each face: coplanar adjacent faces share one.
    corners : (f, 4, 3) float64, map frame, metres
    seen_m2 : (f,) float64
        Area of each face that at least two scans saw, in squares of 0.1 m.
    stamps_s : (k,) float64
    trajectory : (k, 4, 4) float64
        ``T_map_sensor``.
    """

    scans: list[Floats]
    faces: list[Ints]
    plane_of: Ints
    corners: Floats
    seen_m2: Floats
    stamps_s: Floats
    trajectory: Floats


def simulate_storey(
    sensor: Sensor = "lidar",
    sigma: float = 0.01,
    iterations: int = 60,
    seed: int = 0,
    storeys: int = 1,
    moving: int = 0,
) -> Storey:
    """Simulate a sensor carried through a storey, or up the stairs of a house with two.

    Parameters
    ----------
    sensor : "lidar" or "depth"
        Rings all around, or a depth camera, whose noise grows with the square of the depth.
    sigma : float, metres
        Standard deviation of a range; of the depth camera at 2 m.
    iterations : int
    seed : int
    storeys : 1 or 2
        Two rooms, one with a sloped roof, or a house of four rooms with stairs and a gable roof.
    moving : int
        Number of boxes, 0.8 m long and 1.1 m high, that are moved to and fro.

    Returns
    -------
    Storey
        The scans, the true poses and the true faces.

    Raises
    ------
    RelmapError
        If a setting is out of range.
    """
    limits = [
        (sensor in get_args(Sensor), f"sensor is {sensor!r}; it must be 'lidar' or 'depth'"),
        (1 <= iterations <= 10**6, f"iterations is {iterations}; it must lie in [1, 1000000]"),
        (storeys in (1, 2) and 0 <= moving <= 1000, "storeys must be 1 or 2, moving 0 to 1000"),
    ]
    check_arguments("gaussian", sigma, seed, *limits)
    rng, rooms = np.random.default_rng(seed), house(storeys)
    rays = _lidar_rays() if sensor == "lidar" else _camera_rays()
    poses = (_carried if storeys == 1 else _carried_upstairs)(iterations, sensor, rooms.stops)
    boxes = _moved(moving, iterations, rooms, seed)
    scans, faces, squares = [], [], Squares(rooms.origin, rooms.sides)
    for pose, (origin, sides) in zip(poses, boxes, strict=True):
        there = np.concatenate([rooms.origin, origin]), np.concatenate([rooms.sides, sides])
        range_m, face = cast_rays(pose[:3, 3], rays @ pose[:3, :3].T, *there)
        seen, face = range_m < FARTHEST_M, np.where(face < len(rooms.origin), face, -1)
        still = seen & (face >= 0)
        points = pose[:3, 3] + range_m[still, None] * rays[still] @ pose[:3, :3].T
        squares.see(points, face[still])
        noise = sigma * rng.standard_normal(seen.sum())
        if sensor == "depth":
            noise *= (range_m[seen] * rays[seen, 0] / 2) ** 2
        scans.append(np.abs(range_m[seen] + noise)[:, None] * rays[seen])
        faces.append(face[seen])
    steps = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = rooms.origin[:, None] + steps @ rooms.sides
    stamps_s = np.arange(iterations, dtype=np.float64)
    plane_of = _plane_of(rooms.origin, rooms.sides)
    return Storey(scans, faces, plane_of, corners, squares.seen_m2, stamps_s, poses)


class Squares:
    """Squares of faces, and how many scans saw each; `origin` (f, 3), `sides` (f, 2, 3)."""

    def __init__(self, origin: Floats, sides: Floats) -> None:
        self._origin, self._sides = origin, sides
        self._length_m = np.linalg.norm(sides, axis=2)
        counts = np.maximum(np.round(self._length_m / SQUARE_M), 1).astype(np.int64)
        self._scans = [np.zeros(count, dtype=np.int64) for count in counts.tolist()]

    def see(self, points: Floats, face: Ints) -> None:
        """Take in the points (n, 3) of a scan, without noise, and their faces (n,)."""
        for k in np.unique(face):
            scans, length_m = self._scans[k], self._length_m[k]
            share = (points[face == k] - self._origin[k]) @ self._sides[k].T / length_m**2
            at = np.clip((share * scans.shape).astype(np.int64), 0, np.array(scans.shape) - 1)
            scans[at[:, 0], at[:, 1]] += 1  # once, however many points are there

    @property
    def seen_m2(self) -> Floats:
        """Area of each face (f,) that at least two scans saw."""
        share = [(scans > 1).mean() for scans in self._scans]
        return np.asarray(share * self._length_m.prod(axis=1))


def cast_rays(start: Floats, rays: Floats, origin: Floats, sides: Floats) -> tuple[Floats, Ints]:
    """Return the distances of rays (n, 3) from a point to the faces (n,) they hit."""
    range_m, face = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for k, (corner, (a, b)) in enumerate(zip(origin, sides, strict=True)):
        normal = np.cross(a, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((corner - start) @ normal) / (rays @ normal)
        nearer = np.flatnonzero((t > 1e-6) & (t < range_m))
        at = start + t[nearer, None] * rays[nearer] - corner
        gram = np.linalg.inv(np.array([[a @ a, a @ b], [a @ b, b @ b]]))
        share = (at @ np.stack([a, b]).T) @ gram
        hit = nearer[((share >= 0) & (share <= 1)).all(axis=1)]
        range_m[hit], face[hit] = t[hit], k
    return range_m, face


def _plane_of(origin: Floats, sides: Floats) -> Ints:
    normal = np.cross(sides[:, 0], sides[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off = np.abs((origin[None] - origin[:, None]) @ normal[:, :, None])[..., 0]
    same = (np.abs(normal @ normal.T) > 1 - 1e-9) & (off < 1e-9)
    return np.unique(same.argmax(axis=1), return_inverse=True)[1]


def _lidar_rays() -> Floats:
    elevation = np.linspace(LOWEST_RAD, HIGHEST_RAD, RINGS)[:, None]
    azimuth = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    return np.stack([x, y, np.sin(elevation) * np.ones(BEAMS)], axis=-1).reshape(-1, 3)


def _camera_rays() -> Floats:
    row, column = np.mgrid[:ROWS, :COLUMNS]
    y, z = -(column - (COLUMNS - 1) / 2) / FOCAL, -(row - (ROWS - 1) / 2) / FOCAL
    rays = np.stack([np.ones_like(y), y, z], axis=-1).reshape(-1, 3)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _moved(count: int, iterations: int, rooms: House, seed: int) -> list[tuple[Floats, Floats]]:
    """Return the faces of all moving boxes in each scan: corners and sides, as in `House`."""
    rng = np.random.default_rng([seed, 1])
    origin, sides = np.empty((iterations, 6 * count, 3)), np.empty((iterations, 6 * count, 2, 3))
    for number in range(count):
        track = rooms.tracks[number % len(rooms.tracks)]
        step = rng.uniform(*MOVED_M) / np.linalg.norm(track[1] - track[0])
        way = rng.uniform(0, 2) + step * np.arange(iterations)
        rows = slice(6 * number, 6 * number + 6)
        for k, share in enumerate(1 - np.abs(way % 2 - 1)):
            origin[k, rows], sides[k, rows] = moving_box(track, share)
    return list(zip(origin, sides, strict=True))


def _carried(iterations: int, sensor: Sensor, stops: Floats) -> Floats:
    """Return a path from the first room through the door into the second, with hand-held tilt."""
    s = np.linspace(0, 1, iterations)
    place = places_along(stops, np.linspace(0, 1, len(stops)), s)
    sway = np.sin(2 * np.pi * s)
    yaw = 0.5 * np.sin(4 * np.pi * s) if sensor == "lidar" else 0.9 * sway
    return _poses(place, yaw, 0.15 * np.sin(6 * np.pi * s), 0.2 * np.sin(5 * np.pi * s))


def _carried_upstairs(iterations: int, sensor: Sensor, stops: Floats) -> Floats:
    """Return a path at constant speed, looking ahead, with hand-held tilt."""
    from scipy.ndimage import gaussian_filter1d

    step_m, length_m = 0.01, lengths_along(stops)
    s = np.arange(0.0, length_m[-1], step_m)
    way = places_along(stops, length_m, s)
    way = gaussian_filter1d(way, SMOOTH_M / step_m, axis=0, mode="nearest")
    heading = np.unwrap(np.arctan2(*np.gradient(way, axis=0)[:, 1::-1].T))
    heading = gaussian_filter1d(heading, SMOOTH_M / step_m, mode="nearest")
    rows = np.round(np.linspace(0, len(s) - 1, iterations)).astype(np.int64)
    phase = 2 * np.pi * s[rows] / SWAY_M
    yaw = heading[rows] + (0.5 if sensor == "lidar" else 0.2) * np.sin(0.7 * phase)
    return _poses(way[rows], yaw, 0.15 * np.sin(phase), 0.2 * np.sin(0.8 * phase))


def _poses(place: Floats, yaw: Floats, pitch: Floats, roll: Floats) -> Floats:
    return poses_of(Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])), place)
