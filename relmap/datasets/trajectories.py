"""True paths as files of poses, and manually checked relations between poses.

Paths are in the format of TUM (``t x y z qx qy qz qw``) or of KITTI (3 x 4 matrices by rows).
KITTI's poses have no times: they are read from ``times.txt`` beside the file, one per line,
otherwise line numbers from 0 are used.

Relations are the ground truth of real laser logs (R. Kuemmerle et al., "On measuring the accuracy
of SLAM algorithms", Autonomous Robots 27, 2009). Each line is ``t1 t2 x y z roll pitch yaw``: the
pose at t2 in the frame of the pose at t1.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.kitti_bin import TIMES, read_poses, read_times
from relmap.datasets.number_rows import finite_numbers, read_rows
from relmap.datasets.odometry import read_tum
from relmap.datasets.scans import poses_of
from relmap.datasets.textfile import invalid, numbered_lines, shown

_TUM, _KITTI = 8, 12
_RELATION = "t1 t2 x y z roll pitch yaw"
_RELATION_LIMITS = (1e12, 1e12, *[MAX_COORDINATE_M] * 6)


def is_trajectory(path: Path) -> bool:
    """Return whether the first line other than a comment has 8 or 12 numbers."""
    with suppress(RelmapError):
        cells = _first_row(path)
        return len(cells) in (_TUM, _KITTI) and bool(finite_numbers(cells))
    return False


def _first_row(path: Path) -> list[str]:
    """Return the words of the first line other than a comment; none if there is no such line."""
    rows = (line.partition("#")[0].split() for _, line in numbered_lines(path))
    return next(filter(None, rows), [])


def read_trajectory(path: Path) -> tuple[Floats, Floats]:
    """Read a path recognised by `is_trajectory`.

    Returns `stamps_s` (k,): seconds, or the numbers of the lines and `poses` (k, 4, 4):
    T_map_robot. Raises `RelmapError` if a line is not a pose.
    """
    if len(_first_row(path)) == _TUM:
        stamps_s, poses, _ = read_tum(path)
        return stamps_s, poses
    poses = read_poses(path)
    return _times_of(path, len(poses)), poses


def _times_of(path: Path, n_poses: int) -> Floats:
    times = path.with_name(TIMES)
    if not os.path.isfile(times):
        return np.arange(n_poses, dtype=np.float64)
    stamps_s = read_times(times)
    if len(stamps_s) != n_poses:
        raise invalid(times, f"{len(stamps_s)} times, expected {n_poses} as in {shown(path.name)}")
    return stamps_s


@dataclass(frozen=True, eq=False)
class Relations:
    """True relative poses, as a structure of arrays.

    `begin_s`, `end_s` (r,): times of the two poses, seconds, by the log's clock; `T_begin_end`
    (r, 4, 4): the later pose in the frame of the earlier one, metres.
    """

    begin_s: Floats
    end_s: Floats
    T_begin_end: Floats


def read_relations(path: Path) -> Relations:
    """Read a ``.relations`` file; RelmapError if it has no relation, or a line is none."""
    table = read_rows(path, _RELATION_LIMITS, "relation", f"8 numbers: {_RELATION}").values
    T = poses_of(Rotation.from_euler("xyz", table[:, 5:]), table[:, 2:5])
    return Relations(table[:, 0], table[:, 1], T)
