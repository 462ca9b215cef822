"""MRCLAM: five robots among landmarks with bar codes (Leung, Halpern, Barfoot and Liu, IJRR 2011).

A folder with, for robots 1, 2 and so on, plain or gzipped, ``#`` before a comment:

* ``Barcodes.dat``: number of a subject, and its bar code; subjects 1 to 5 are robots.
* ``RobotN_Measurement.dat``: t s, bar code, range m, bearing rad (to the left). Rows with equal
  time are one image.
* ``RobotN_Odometry.dat``: t s, forward velocity m/s, angular velocity rad/s, as commanded.
* ``RobotN_Groundtruth.dat``: t s, x m, y m, heading rad, by Vicon.
* ``Landmark_Groundtruth.dat``: subject, x m, y m and their standard deviations.

An image with a landmark is an iteration. Ids are the subject numbers; other robots, which move, and
unknown bar codes are left out. The folder is one log of all robots in sequence, with unknown motion
from the last image of one to the first of the next; a file of measurements is the log of one robot.
(N - 1) x 100 000 s are added to the times of robot N, so that times ascend.
"""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.datasets.assembly import MAX_COORDINATE_M, from_polar
from relmap.datasets.base import ObservationLog
from relmap.datasets.headers import file_beside
from relmap.datasets.number_rows import read_rows, warn_unsorted
from relmap.datasets.odometry import driven, poses_at
from relmap.datasets.scans import planar_poses
from relmap.datasets.table import MAX_EXACT_INTEGER
from relmap.datasets.textfile import invalid, warn

BARCODES, LANDMARKS = "Barcodes.dat", "Landmark_Groundtruth.dat"
ROBOTS = 5
"""Subjects up to this number are robots."""
APART_S = 100_000.0
"""Offset between the times of two robots of one log: more than a day."""

MOST_ROBOTS = 99
_NAME = re.compile(r"Robot([1-9]\d?)_(Measurement|Odometry|Groundtruth)\.dat(\.gz)?$")
_TIME, _ANGLE, _SPEED = 1e12, 1e6, 1e3


class Mrclam:
    """Reads the folder, or the measurements of one robot in it."""

    name = "mrclam"
    description = f"MRCLAM's folder with {BARCODES} and RobotN_Measurement.dat, or one such file"

    def recognises(self, path: Path) -> bool:
        """Return whether there are bar codes and measurements."""
        return os.path.isfile(file_beside(path, BARCODES)) and bool(_robots(path))

    def load(self, path: Path) -> ObservationLog:
        """Read the log: planar, with the available odometry."""
        robots = _robots(path)
        if not robots:
            raise invalid(path, f"holds no measurements, expected {self.description}")
        subjects, parts, n_scans, n_rows = _subjects(file_beside(path, BARCODES)), [], 0, 0
        for robot, file in robots.items():
            part, n_measured = _drive(robot, file, subjects)
            iteration, rows = n_scans + part.iteration, n_rows + part.rows
            parts.append(vars(replace(part, iteration=iteration, rows=rows)))
            n_scans, n_rows = n_scans + len(part), n_rows + n_measured
        names = ("points_robot", "iteration", "rows", "ids", "stamps_s", "odometry")
        whole: dict[str, Any] = {
            name: np.concatenate([part[name] for part in parts]) for name in names
        }
        if not n_scans:
            raise invalid(path, "no bar code is that of a landmark, expected some")
        if (np.diff(whole["stamps_s"]) <= 0).any():
            raise invalid(path, "robots are days apart, expected those of one run")
        log = ObservationLog(**whole, first_iteration=0, end_iteration=n_scans)
        known = any(_file(file.parent, robot, "Odometry") for robot, file in robots.items())
        return log if known else replace(log, odometry=None)


def _drive(robot: int, file: Path, subjects: dict[int, int]) -> tuple[ObservationLog, int]:
    """Return the log of one robot, with unknown motion without a file, and its number of rows."""
    measured = _measured(file)
    measured[:, 1] = [subjects.get(int(code), -1) for code in measured[:, 1]]
    warn_unsorted(file, measured[:, 0], "measurements")
    if unknown := int((measured[:, 1] < 0).sum()):
        warn(file, f"{unknown} unknown bar codes are left out")
    rows = np.flatnonzero(measured[:, 1] > ROBOTS)
    rows = rows[np.lexsort((rows, measured[rows, 1], measured[rows, 0]))]
    same = (np.diff(measured[rows, :2], axis=0) == 0).all(axis=1)
    rows = np.delete(rows, np.flatnonzero(same) + 1)  # duplicate landmark in one image
    t, subject, range_m, bearing_rad = measured[rows].T
    points = from_polar(range_m, bearing_rad)
    stamps_s, iteration = np.unique(t, return_inverse=True)
    motion = _odometry(_file(file.parent, robot, "Odometry"), stamps_s)
    log = ObservationLog(points, iteration, rows, 0, len(stamps_s), subject.astype(np.int64))
    return replace(log, stamps_s=_shifted(stamps_s, robot), odometry=motion), len(measured)


def is_ground_truth(path: Path) -> bool:
    """Return whether the true landmarks are in a folder, or beside a file of a robot."""
    return os.path.isfile(file_beside(path, LANDMARKS)) and (
        os.path.isdir(path) or path.name == LANDMARKS or bool(_NAME.fullmatch(path.name))
    )


def read_ground_truth(path: Path | str) -> tuple[Ints, Floats, Floats, Floats]:
    """Read the truth: surveyed landmarks, and the robot poses by Vicon.

    `path`: the folder, or any file in it. Returns `landmark_ids` (m,), `positions` (m, 3), metres:
    z = 0, `stamps_s` (k,): the times of the images of all robots, as in the log, at which Vicon saw
    the robot and `poses` (k, 4, 4): T_map_robot. Raises `RelmapError` if a file is missing or
    damaged.
    """
    path = Path(path)
    folder = path if os.path.isdir(path) else path.parent
    limits, expected = [MAX_COORDINATE_M] * 5, "5 numbers: subject x y sd sd"
    landmarks = read_rows(folder / LANDMARKS, limits, "landmark", expected).values
    found = [(np.empty(0), np.empty((0, 4, 4)))]
    for robot, measured in _robots(folder).items():
        file = _file(folder, robot, "Groundtruth")
        if file is not None:
            images = np.unique(_measured(measured)[:, 0])
            limits = [_TIME, MAX_COORDINATE_M, MAX_COORDINATE_M, _ANGLE]
            rows = read_rows(file, limits, "pose", "4 numbers: t x y heading").values
            t, first = np.unique(rows[:, 0], return_index=True)
            poses = poses_at(t, planar_poses(*rows[first, 1:].T), images)
            there = np.isfinite(poses[:, 0, 0])
            found.append((_shifted(images[there], robot), poses[there]))
    positions = np.column_stack([landmarks[:, 1:3], np.zeros(len(landmarks))])
    stamps_s, poses = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return landmarks[:, 0].astype(np.int64), positions, stamps_s, poses


def _measured(file: Path) -> Floats:
    expected = "4 numbers: t bar-code range bearing"
    limits = (_TIME, MAX_EXACT_INTEGER, MAX_COORDINATE_M, _ANGLE)
    return read_rows(file, limits, "measurement", expected).values


def _odometry(file: Path | None, at_s: Floats) -> Floats:
    """Return the motions (k, 4, 4) of a robot between images; NaN without a file."""
    if file is None:
        return np.full((len(at_s), 4, 4), np.nan)
    limits = (_TIME, _SPEED, _SPEED)
    rows = read_rows(file, limits, "velocity", "3 numbers: t forward angular").values
    warn_unsorted(file, rows[:, 0], "velocities")
    stamps_s, speed, turn = rows[np.argsort(rows[:, 0], kind="stable")].T
    return driven(file, stamps_s, speed, turn, at_s)


def _shifted(stamps_s: Floats, robot: int) -> Floats:
    return stamps_s + (robot - 1) * APART_S


def _subjects(file: Path) -> dict[int, int]:
    rows = read_rows(file, [MAX_EXACT_INTEGER] * 2, "bar code", "2 numbers: subject bar code")
    codes, counts = np.unique(rows.values[:, 1], return_counts=True)
    if (counts > 1).any():
        raise invalid(file, f"bar code {codes[counts > 1][0]:.0f} is duplicated")
    return {int(code): int(subject) for subject, code in rows.values}


def _robots(path: Path) -> dict[int, Path]:
    """Return the measurements of each robot: of one, or of all in a folder."""
    if not os.path.isdir(path):
        name = _NAME.fullmatch(path.name)
        return {int(name[1]): path} if name and name[2] == "Measurement" else {}
    files = {robot: _file(path, robot, "Measurement") for robot in range(1, MOST_ROBOTS + 1)}
    return {robot: file for robot, file in files.items() if file is not None}


def _file(folder: Path, robot: int, kind: str) -> Path | None:
    """Return a file of a robot, plain or gzipped, if it exists."""
    files = (folder / f"Robot{robot}_{kind}.dat{end}" for end in ("", ".gz"))
    return next(filter(os.path.isfile, files), None)
