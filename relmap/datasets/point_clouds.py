"""A folder of point clouds, one file per scan: PCD or PLY, plain or packed by xz.

The scans are sorted by the numbers in their names. ``alidarPose.csv`` beside them (as in BALM, Z.
Liu and F. Zhang, RA-L 2021) gives the reference poses: rows 4N to 4N + 3 are the matrix
T_reference_robot of file number N, with the time, which then defines the order, in its last cell.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from relmap.datasets.cloud_file import is_cloud, read_cloud
from relmap.datasets.headers import numbered_files, numbers_in_name
from relmap.datasets.number_rows import read_rows
from relmap.datasets.scans import ScanLog, require_rotations, sorted_by_time
from relmap.datasets.textfile import invalid, shown

POSES_FILE = "alidarPose.csv"
_ROW = "4 numbers: a row of a 4 x 4 matrix"

_NAME = re.compile(r"\.(pcd|ply)(\.xz)?$", re.IGNORECASE)
_RESULT, _MAP = "summary.json", "map.ply"
"""A folder with the first holds a result, and the second is its map."""


class PointClouds:
    """Reads a folder of PCD or PLY files, or one such file."""

    name = "point-clouds"
    description = "a folder of .pcd or .ply files (or .xz)"

    def recognises(self, path: Path) -> bool:
        """Return whether it is such a file, or a folder of them, not just of a map of relmap."""
        if not os.path.isdir(path):
            return is_cloud(path)
        return bool(_clouds(path))

    def load(self, path: Path) -> ScanLog:
        """Read the log; clouds are read lazily, without NaN, which are beams without a return."""
        files = _clouds(path) if os.path.isdir(path) else [path]
        if not files:
            raise invalid(path, f"holds no cloud, expected {self.description}")
        numbers, poses_file = np.arange(len(files), dtype=float), files[0].with_name(POSES_FILE)
        log = ScanLog(3, numbers, lambda index: read_cloud(files[index]))
        if not poses_file.is_file():
            return log
        stamps_s, poses = _read_poses(poses_file, files)
        return sorted_by_time(poses_file, replace(log, poses=poses), stamps_s)


def _clouds(folder: Path) -> list[Path]:
    """Return the clouds in a folder, without the map of a result written there."""
    is_result = (folder / _RESULT).exists()
    return [file for file in numbered_files(folder, _NAME) if not (is_result and file.name == _MAP)]


def _read_poses(file: Path, clouds: list[Path]) -> tuple[Floats, Floats]:
    """Return the stamps (k,) and poses (k, 4, 4) of the clouds."""
    rows = read_rows(file, [sys.float_info.max] * 4, "row", _ROW, separator=",").values
    numbers = [numbers_in_name(cloud, _NAME) for cloud in clouds]
    for cloud, name in zip(clouds, numbers, strict=True):
        if len(name) != 1 or 4 * name[0] + 4 > len(rows):
            problem = f"no rows for {shown(cloud.name)}, expected 4 for each number from 0"
            raise invalid(file, problem)
    first = 4 * np.array(numbers)
    matrices = rows[first + np.arange(4)]
    stamps_s = matrices[:, 3, 3].copy()
    if matrices[:, 3, :3].any() or len(rows) % 4:
        raise invalid(file, "not 4 rows a pose, expected the last to be 0, 0, 0, t")
    matrices[:, 3] = [0.0, 0.0, 0.0, 1.0]
    require_rotations(file, matrices)
    return stamps_s, matrices
