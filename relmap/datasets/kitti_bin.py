"""A folder of clouds as KITTI stores them: one .bin file per scan, four float32 a point.

The four are x, y, z (metres) and the reflectance, 0 to 1 (A. Geiger et al., IJRR 2013).  The scans
are sorted by the numbers in their names. Reference poses are a file ``poses.txt`` beside the clouds
or in the parent folder, with the upper three rows of T_reference_robot in each line; or a folder
``poses`` beside the folder of clouds, with a text file of the same name for each scan, with
position and quaternion: x, y, z, qx, qy, qz, qw (as in PlaneSLAM, A. Dai et al., 2022, for AirSim).
Times are a file ``times.txt`` in the places of ``poses.txt``, with the seconds in each line.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.core.stamps import MAX_S
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.foreign import is_kitti
from relmap.datasets.headers import numbered_files
from relmap.datasets.number_rows import finite_numbers, read_rows
from relmap.datasets.point_clouds import MAX_BYTES
from relmap.datasets.scans import ScanLog, poses_of, require_rotations, sorted_by_time
from relmap.datasets.textfile import invalid, numbered_lines, unreadable

POSES, POSES_FOLDER, TIMES = "poses.txt", "poses", "times.txt"
FOLDERS = ("", "lidar", "velodyne", "velodyne_points/data")
"""Subfolder of the clouds."""

_CLOUD = re.compile(r"\.bin$")


class KittiBin:
    """Reads a folder of .bin files, or a folder with such a subfolder."""

    name = "kitti-bin"
    description = "a folder of .bin files"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a folder whose first .bin file may be a KITTI cloud."""
        files = _files(path)
        return bool(files) and is_kitti(files[0])

    def load(self, path: Path) -> ScanLog:
        """Read the log; clouds are read lazily."""
        files = _files(path)
        if not files:
            raise invalid(path, f"holds no .bin file, expected {self.description}")
        numbers, times = np.arange(len(files), dtype=np.float64), _beside(files, TIMES)
        log = ScanLog(3, numbers, lambda index: _read_cloud(files[index]), _poses(files))
        if times is None:
            return log
        return sorted_by_time(times, log, _one_each(times, read_times(times), files, "times"))


def _files(path: Path) -> list[Path]:
    """Return the clouds in a folder or in its subfolder, in order; none if it is a file."""
    folders = (path / inner for inner in FOLDERS)
    found = (numbered_files(folder, _CLOUD) for folder in folders if os.path.isdir(folder))
    return next(filter(None, found), [])


def _read_cloud(file: Path) -> Floats:
    """Return the points (n, 3) of a file, metres; n may be 0."""
    try:
        if file.stat().st_size > MAX_BYTES:
            raise invalid(file, f"more than {MAX_BYTES} bytes, expected at most that")
        data = file.read_bytes()
    except OSError as error:
        raise unreadable(file, error) from error
    expected = "expected four float32 for each point: x, y, z (metres) and reflectance"
    if len(data) % 16:
        raise invalid(file, f"{len(data)} bytes, {expected}")
    rows = np.frombuffer(data, "<f4").reshape(-1, 4)
    if (rows[:, 3] < 0).any():
        raise invalid(file, f"a reflectance is below 0, {expected}")
    points = rows[:, :3].astype(np.float64)
    points = points[~np.isnan(points).any(axis=1)]
    if not (np.abs(points) <= MAX_COORDINATE_M).all():
        raise invalid(file, f"a point is out of range, {expected}")
    return points


def _beside(files: list[Path], name: str) -> Path | None:
    """Return the file of this name beside the clouds or in the parent folder, if there is one."""
    folder = files[0].parent
    return next((path / name for path in (folder, folder.parent) if (path / name).is_file()), None)


def _one_each(file: Path, values: Floats, files: list[Path], what: str) -> Floats:
    """Return the values in a file that are of the clouds; RelmapError if they are too few."""
    if len(values) < len(files):
        raise invalid(file, f"{len(values)} {what}, expected one for each of {len(files)} clouds")
    return values[: len(files)]


def _poses(files: list[Path]) -> Floats | None:
    """Return T_reference_robot (k, 4, 4) of each scan; None without reference poses."""
    file = _beside(files, POSES)
    if file is not None:
        return _one_each(file, read_poses(file), files, "poses")
    folder = files[0].parent
    each = [folder.parent / POSES_FOLDER / f"{file.stem}.txt" for file in files]
    if not each[0].is_file():
        return None
    rows = np.array([_seven(file) for file in each])
    return poses_of(Rotation.from_quat(rows[:, 3:]), rows[:, :3])


def read_poses(file: Path) -> Floats:
    """Return the poses (k, 4, 4) in a file with a 3 x 4 matrix, by rows, in each line."""
    expected = "12 numbers: a 3 x 4 matrix of a pose, by rows"
    rows = read_rows(file, [MAX_COORDINATE_M] * 12, "pose", expected).values
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows.reshape(-1, 3, 4)
    require_rotations(file, poses)
    return poses


def read_times(file: Path) -> Floats:
    """Return the times (k,) in a file with the seconds in each line."""
    return np.asarray(read_rows(file, [MAX_S], "time", "one number: seconds").values[:, 0])


def _seven(file: Path) -> Floats:
    """Return position and quaternion (7,); the quaternion may be omitted."""
    text = " ".join(line for _, line in numbered_lines(file))
    numbers = np.array(finite_numbers(text.replace(",", " ").split()))
    if len(numbers) == 3:
        numbers = np.append(numbers, [0.0, 0.0, 0.0, 1.0])
    if len(numbers) != 7 or not numbers[3:].any():
        raise invalid(file, f"{len(numbers)} numbers, expected x, y, z, qx, qy, qz, qw")
    return numbers
