"""A storey in space with exact truth: two rooms, a sloped roof, tables, and a carried sensor.

Faces are two-sided parallelograms. Rays of the sensor end at the first face they hit; the noise is
along the ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.brief import Brief
from relmap.core.errors import RelmapError

Sensor = Literal["lidar", "depth"]
RINGS, BEAMS, HIGHEST_RAD, LOWEST_RAD = 32, 300, np.deg2rad(40.0), np.deg2rad(-40.0)
"""Rings of the lidar, beams per ring, and elevations of the outermost rings."""
ROWS, COLUMNS, FOCAL = 120, 160, 104.0
"""Of the depth camera: pixels, and its focal length in pixels."""
FARTHEST_M = 30.0
SQUARE_M = 0.1
"""Size of the squares in which the area that was seen is counted."""
DOOR = 3.0, 3.9, 2.0
"""Start and end of the door along the wall between the rooms, and its height, metres."""


@dataclass(frozen=True, eq=False, repr=False)
class Storey(Brief):
    """A simulated run.

    Attributes
    ----------
    scans : list of (n, 3) float64, sensor frame, metres
    faces : list of (n,) int64
        The face of each point.
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
    sensor: Sensor = "lidar", sigma: float = 0.01, iterations: int = 60, seed: int = 0
) -> Storey:
    """Simulate a sensor carried through a storey.

    Parameters
    ----------
    sensor : "lidar" or "depth"
        Rings all around, or a depth camera, whose noise grows with the square of the depth.
    sigma : float, metres
        Standard deviation of a range; of the depth camera at 2 m.
    iterations : int
    seed : int

    Returns
    -------
    Storey
        The scans, the true poses and the true faces.

    Raises
    ------
    RelmapError
        If a setting is out of range.
    """
    if sensor not in ("lidar", "depth"):
        raise RelmapError(f"sensor is {sensor!r}; it must be 'lidar' or 'depth'")
    if not 0 <= sigma < np.inf or iterations < 1:
        raise RelmapError("sigma must be 0 or more, and iterations at least 1")
    rng = np.random.default_rng(seed)
    origin, sides = storey_faces()
    rays = _lidar_rays() if sensor == "lidar" else _camera_rays()
    trajectory = _carried(iterations, sensor)
    scans, faces, squares = [], [], Squares(origin, sides)
    for pose in trajectory:
        range_m, face = cast_rays(pose[:3, 3], rays @ pose[:3, :3].T, origin, sides)
        seen = range_m < FARTHEST_M
        squares.see(pose[:3, 3] + range_m[seen, None] * rays[seen] @ pose[:3, :3].T, face[seen])
        noise = sigma * rng.standard_normal(seen.sum())
        if sensor == "depth":
            noise *= (range_m[seen] * rays[seen, 0] / 2) ** 2
        scans.append((range_m[seen] + noise)[:, None] * rays[seen])
        faces.append(face[seen])
    steps = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = origin[:, None] + steps @ sides
    stamps_s = np.arange(iterations, dtype=np.float64)
    plane_of = _plane_of(origin, sides)
    return Storey(scans, faces, plane_of, corners, squares.seen_m2, stamps_s, trajectory)


class Squares:
    """Squares of faces, and how many scans saw each.

    `origin` (f, 3); `sides` (f, 2, 3): at right angles.
    """

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
            at = np.unique(at, axis=0)
            scans[at[:, 0], at[:, 1]] += 1

    @property
    def seen_m2(self) -> Floats:
        """Area of each face (f,) that at least two scans saw."""
        share = [(scans > 1).mean() for scans in self._scans]
        return np.asarray(share * self._length_m.prod(axis=1))


def storey_faces() -> tuple[Floats, Floats]:
    """Return the faces: a corner (f, 3) of each, and its two sides (f, 2, 3), metres."""
    begin, end, high = DOOR
    faces: list[tuple[ArrayLike, ArrayLike, ArrayLike]] = [
        ((0, 0, 0), (12, 0, 0), (0, 7, 0)),  # floor
        ((0, 0, 2.7), (6, 0, 0), (0, 7, 0)),  # ceiling of the first room
        ((6, 0, 3.4), (6, 0, 0), (0, 7, -1.9)),  # sloped roof of the second
        ((0, 0, 0), (12, 0, 0), (0, 0, 3.5)),
        ((0, 7, 0), (12, 0, 0), (0, 0, 3.5)),
        ((0, 0, 0), (0, 7, 0), (0, 0, 3.5)),
        ((12, 0, 0), (0, 7, 0), (0, 0, 3.5)),
        ((6, 0, 0), (0, begin, 0), (0, 0, 3.5)),  # the wall with the door
        ((6, end, 0), (0, 7 - end, 0), (0, 0, 3.5)),
        ((6, begin, high), (0, end - begin, 0), (0, 0, 3.5 - high)),
    ]
    for x, y, z, wide, deep, tall, turn in (
        (1.2, 5.2, 0.65, 1.6, 0.9, 0.1, 0.3),  # tables: thick boards
        (8.5, 2.2, 0.7, 1.8, 1.0, 0.1, -0.4),
        (0.2, 0.2, 0.0, 0.6, 1.5, 1.9, 0.0),  # cupboards
        (10.3, 5.6, 0.0, 1.2, 0.8, 1.1, 0.2),
    ):
        faces += _box(np.array([x, y, z]), wide, deep, tall, turn)
    array = np.array(faces, dtype=np.float64)
    return array[:, 0], array[:, 1:]


def cast_rays(start: Floats, rays: Floats, origin: Floats, sides: Floats) -> tuple[Floats, Ints]:
    """Return the distances of rays (n, 3) from a point to the faces (n,) they hit."""
    range_m, face = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for k, (corner, (a, b)) in enumerate(zip(origin, sides, strict=True)):
        normal = np.cross(a, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((corner - start) @ normal) / (rays @ normal)
            at = start + t[:, None] * rays - corner
            gram = np.linalg.inv(np.array([[a @ a, a @ b], [a @ b, b @ b]]))
            share = (at @ np.stack([a, b]).T) @ gram
            hit = (t > 1e-6) & (t < range_m) & ((share >= 0) & (share <= 1)).all(axis=1)
        range_m[hit], face[hit] = t[hit], k
    return range_m, face


def _box(
    corner: Floats, wide: float, deep: float, tall: float, turn: float
) -> list[tuple[ArrayLike, ArrayLike, ArrayLike]]:
    u = wide * np.array([np.cos(turn), np.sin(turn), 0.0])
    v = deep * np.array([-np.sin(turn), np.cos(turn), 0.0])
    w = np.array([0.0, 0.0, tall])
    sides = [(u, v), (u, w), (v, w)]
    far = [corner + opposite for opposite in (w, v, u)]
    return [(at, a, b) for at, (a, b) in zip([corner] * 3 + far, sides * 2, strict=True)]


def _plane_of(origin: Floats, sides: Floats) -> Ints:
    normal = np.cross(sides[:, 0], sides[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off = np.abs((origin[None] - origin[:, None]) @ normal[:, :, None])[..., 0]
    same = (np.abs(normal @ normal.T) > 1 - 1e-9) & (off < 1e-9)
    return np.unique(same.argmax(axis=1), return_inverse=True)[1]


def _lidar_rays() -> Floats:
    elevation = np.linspace(LOWEST_RAD, HIGHEST_RAD, RINGS)[:, None]
    azimuth = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation) * np.ones(BEAMS),
        ],
        axis=-1,
    )
    return rays.reshape(-1, 3)


def _camera_rays() -> Floats:
    row, column = np.mgrid[:ROWS, :COLUMNS]
    y, z = -(column - (COLUMNS - 1) / 2) / FOCAL, -(row - (ROWS - 1) / 2) / FOCAL
    rays = np.stack([np.ones_like(y), y, z], axis=-1).reshape(-1, 3)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _carried(iterations: int, sensor: Sensor) -> Floats:
    """Return a path from the first room through the door into the second, with hand-held tilt."""
    s = np.linspace(0, 1, iterations)
    stops = np.array([[1.8, 2.0, 1.3], [3.5, 3.6, 1.5], [6.0, 3.45, 1.4], [8.0, 4.2, 1.3]])
    stops = np.concatenate([stops, [[10.4, 3.4, 1.5]]])
    place = np.column_stack([np.interp(s, np.linspace(0, 1, len(stops)), axis) for axis in stops.T])
    sway = np.sin(2 * np.pi * s)
    yaw = 0.5 * np.sin(4 * np.pi * s) if sensor == "lidar" else 0.9 * sway
    angles = np.column_stack([yaw, 0.15 * np.sin(6 * np.pi * s), 0.2 * np.sin(5 * np.pi * s)])
    trajectory = np.tile(np.eye(4), (iterations, 1, 1))
    trajectory[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    trajectory[:, :3, 3] = place
    return trajectory
