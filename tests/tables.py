"""Tables of landmarks and walls, and paths, made by hand, for tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats
from relmap.core.landmarks import LandmarkTable
from relmap.io.results import Tracks
from relmap.planes.walls.table import PlaneTable

NO_TRACKS = Tracks(*[np.empty(0, np.int64)] * 3)


def landmark_table(position: Floats, **columns: Any) -> LandmarkTable:
    """Return static landmarks (n, 3) in one submap, with numbers for all other columns."""
    n = len(position)
    numbers, ones = np.arange(n), np.ones(n, dtype=np.int64)
    counted = ("landmark", "observations", "first_iteration", "last_iteration")
    usual: dict[str, Any] = dict.fromkeys(counted, numbers) | {"position": position, "level": ones}
    usual |= {"sd": np.full(n, np.nan), "status": np.full(n, "static")}
    return LandmarkTable(**usual | {"submap": 0 * ones, "moving_bin": -ones} | columns)


def wall_table(ends: Floats, **columns: Any) -> PlaneTable:
    """Return static walls (n, 2, 2) without height, normals and corners."""
    n = len(ends)
    counted = ("plane", "observations", "first_iteration", "last_iteration")
    usual: dict[str, Any] = dict.fromkeys(counted, np.arange(n)) | {"ends": ends}
    usual |= {"z_extent": np.zeros((n, 2)), "normal": np.zeros((n, 2))}
    usual |= {"corner": np.full((n, 2), -1), "status": np.full(n, "static")}
    return PlaneTable(**usual | columns)


def poses_along(*axes: ArrayLike) -> Floats:
    """Return poses (k, 4, 4) without rotation at given x and, if given, y and z, each (k,)."""
    at = np.column_stack([np.asarray(axis, dtype=np.float64) for axis in axes])
    poses = np.tile(np.eye(4), (len(at), 1, 1))
    poses[:, : at.shape[1], 3] = at
    return poses


def walls_of(ends: Floats, corner: list[list[int]]) -> PlaneTable:
    """Return walls with these ends (w, 2, 2) and corners (w, 2)."""
    n = len(ends)
    way = ends[:, 1] - ends[:, 0]
    along = way / np.linalg.norm(way, axis=1)[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    return wall_table(ends, normal=normal, corner=np.array(corner), observations=np.full(n, 10))
