"""Range-bearing landmark logs of MRPT's kf-slam demonstrations, as ``*.observations.csv.gz``.

Header ``step,id,range_m,yaw_rad,pitch_rad``; yaw is positive to the left, pitch is positive
DOWN. Comments above the header give the sensor's pose on the robot, and the noise::

    # sensor on robot: t = 0.5 0.2 0.1 ; R (row major) = 1 0 0 0 1 0 0 0 1
    # sigma: range 0.01 m, yaw 0.001745 rad, pitch 0.001745 rad; ...

``X.odometry.csv.gz`` beside ``X.observations.csv.gz``, if it exists, has the header
``step,dx_m,dy_m,dz_m,dyaw_rad,dpitch_rad,droll_rad``: the motion that FOLLOWS each step, in the
robot's frame at that step.

The exact truth of the simulator is beside a log ``X.observations.csv.gz`` in ``X_ground_truth.txt``
(landmarks) and ``X_ground_truth_robot_path.txt``.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.sensor import range_bearing_covariances
from relmap.datasets.assembly import (
    MAX_COORDINATE_M,
    assemble_log,
    from_polar,
    id_column,
    iteration_column,
    metres_column,
)
from relmap.datasets.base import ObservationLog
from relmap.datasets.headers import TABLES, columns_of, only_one, tables_with
from relmap.datasets.number_rows import NumberRows, finite_numbers, read_rows
from relmap.datasets.scans import poses_of
from relmap.datasets.table import Column, Table, header_text, read_table
from relmap.datasets.textfile import invalid

_COLUMNS = (
    iteration_column("step"),
    id_column("id"),
    Column("range_m", 0.0, MAX_COORDINATE_M, "metres"),
    Column("yaw_rad", -math.tau, math.tau, "radians"),
    Column("pitch_rad", -math.tau, math.tau, "radians"),
)
_MOTION = (
    iteration_column("step"),
    *(metres_column(f"d{axis}_m") for axis in "xyz"),
    *(Column(f"d{angle}_rad", -1e3, 1e3, "radians") for angle in ("yaw", "pitch", "roll")),
)
_SPHERICAL = ("range_m", "yaw_rad", "pitch_rad")
_HALLMARK = frozenset({"range_m", "yaw_rad"})
_SENSOR = re.compile(r"sensor on robot: *t = *([^;]*);[^=]*= *(.*)")
_SIGMAS = re.compile(r"sigma: *range +(\S+) +m, *yaw +(\S+) +rad, *pitch +(\S+) +rad")
_ROTATION_TOLERANCE = 1e-4

_LANDMARKS = "_ground_truth.txt"
_PATH = "_ground_truth_robot_path.txt"
_LOG = re.compile(r"\.observations\.csv(\.gz)?$")


class MrptLandmarks:
    """Reads one log of ranges and bearings, or a folder with exactly one."""

    name = "mrpt-landmarks"
    description = f"an MRPT landmark log with the header {header_text(_COLUMNS)}"

    def recognises(self, path: Path) -> bool:
        """Return whether the header is that of an MRPT landmark log, or almost."""
        if os.path.isdir(path):
            return bool(tables_with(path, _HALLMARK))
        return not columns_of(path).isdisjoint({"yaw_rad", "pitch_rad"})

    def load(self, path: Path) -> ObservationLog:
        """Read the log: points in the robot frame, with two columns if the world is planar.

        The world is planar if the pitch is free of noise and always 0, and the sensor is upright.
        """
        file = only_one(path, tables_with(path, _HALLMARK), "MRPT landmark log", TABLES)
        table = read_table(file, _COLUMNS)
        R_robot_sensor, t_robot_sensor = _sensor_pose(table)
        range_m, yaw, pitch = (table.columns[name] for name in _SPHERICAL)
        points_sensor = from_polar(range_m, yaw, -pitch)
        points_robot = points_sensor @ R_robot_sensor.T + t_robot_sensor
        upright = np.array_equal(R_robot_sensor[2], [0.0, 0.0, 1.0])
        sigmas = _sigmas(table)
        planar = upright and sigmas[2] == 0.0 and not table.columns["pitch_rad"].any()
        d = 2 if planar else 3
        noise = None
        if all(0 < sigma < math.inf for sigma in sigmas[:d]):
            R = R_robot_sensor[:d, :d]
            noise = R @ range_bearing_covariances(points_sensor[:, :d], *sigmas[:d]) @ R.T
        log = assemble_log(table, "step", points_robot[:, :d], table.integers("id"), noise)
        base, n = _LOG.subn("", file.name)
        for odometry in (file.with_name(f"{base}.odometry.csv{end}") for end in ("", ".gz")):
            if n and os.path.isfile(odometry):
                return replace(log, odometry=_odometry(odometry, log))
        return log


def _odometry(file: Path, log: ObservationLog) -> Floats:
    """Return the motion (k, 4, 4) to each step; the file refers to the step before."""
    columns = read_table(file, _MOTION).columns
    index = columns["step"].astype(np.int64) + 1 - log.first_iteration
    t = np.column_stack([columns[f"d{axis}_m"] for axis in "xyz"])
    turns = np.column_stack([columns[f"d{angle}_rad"] for angle in ("yaw", "pitch", "roll")])
    odometry = np.full((len(log), 4, 4), math.nan)
    there = (index >= 0) & (index < len(log))
    odometry[index[there]] = poses_of(Rotation.from_euler("ZYX", turns), t)[there]
    return odometry


def _sensor_pose(table: Table) -> tuple[Floats, Floats]:
    """Return rotation (3, 3) and translation (3,) of the sensor on the robot, metres."""
    match = next(filter(None, map(_SENSOR.search, table.comments)), None)
    t, entries = (finite_numbers(part.split()) for part in (match.groups() if match else ("", "")))
    if len(t) == 3 and len(entries) == 9:
        R = np.reshape(entries, (3, 3))
        rigid = np.abs(R @ R.T - np.eye(3)).max() < _ROTATION_TOLERANCE
        if rigid and np.linalg.det(R) > 0:
            return R, np.array(t)
    expected = "'# sensor on robot: t = 0 0 0 ; R (row major) = 1 0 0 0 1 0 0 0 1' (t in metres)"
    problem = f"comments above the header: no usable sensor pose, expected {expected}"
    raise invalid(table.path, problem)


def _sigmas(table: Table) -> Floats:
    """Return the noise (3,) of range, yaw and pitch from the comments; NaN if missing."""
    match = next(filter(None, map(_SIGMAS.search, table.comments)), None)
    sigmas = finite_numbers(match.groups()) if match else []
    return np.array(sigmas or [math.nan] * 3)


def is_ground_truth(path: Path) -> bool:
    """Return whether a path has the name of a truth file, or a folder contains one."""
    if os.path.isdir(path):
        return bool(_landmark_files(path))
    return path.name.endswith((_LANDMARKS, _PATH))


def read_ground_truth(path: Path | str) -> tuple[Ints, Floats, Floats]:
    """Read the exact truth of a log.

    `path`: the log, either of its two truth files, or a folder with the truth of exactly one log.
    Returns `landmark_ids` (m,), `positions` (m, 3), map frame, metres and `poses` (k, 4, 4):
    T_map_robot of every step. Raises `RelmapError` if a file is missing, or a row violates the
    format.
    """
    base = _truth_base(Path(path))
    file = Path(f"{base}{_LANDMARKS}")
    rows = _rows(file, "x y z 5 0 0.0 id")
    landmarks = rows.values
    ids = landmarks[:, 6]
    different, counts = np.unique(ids, return_counts=True)
    wrong = (ids != np.rint(ids)) | np.isin(ids, different[counts > 1])
    if wrong.any():
        row = int(np.argmax(wrong))
        problem = f"field id: {ids[row]:.10g} is not an integer or occurs twice"
        where = f"line {rows.lines[row]}"
        raise invalid(file, f"{where}, {problem}, expected each landmark's own number")
    path_6d = _rows(Path(f"{base}{_PATH}"), "x y z yaw pitch roll").values
    poses = poses_of(Rotation.from_euler("ZYX", path_6d[:, 3:]), path_6d[:, :3])
    return ids.astype(np.int64), landmarks[:, :3].copy(), poses


def _rows(path: Path, columns: str) -> NumberRows:
    """Read rows of numbers; ``%`` starts a comment."""
    n = len(columns.split())
    return read_rows(path, [MAX_COORDINATE_M] * n, "row", f"{n} finite numbers: {columns}", "%")


def _landmark_files(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"*{_LANDMARKS}"))


def _truth_base(path: Path) -> str:
    """Return the common prefix of the names of both truth files, with the folder."""
    if os.path.isdir(path):
        path = only_one(path, _landmark_files(path), "landmark truth", f"*{_LANDMARKS}")
    name = str(path)
    for ending in (_LANDMARKS, _PATH):
        if name.endswith(ending):
            return name.removesuffix(ending)
    return _LOG.sub("", name)
