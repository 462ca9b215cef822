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

import logging
import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.base import ObservationLog
from relmap.datasets.headers import file_beside
from relmap.datasets.number_rows import read_rows, warn_unsorted
from relmap.datasets.odometry import driven, poses_at
from relmap.datasets.scans import planar_poses
from relmap.datasets.table import MAX_EXACT_INTEGER
from relmap.datasets.textfile import shown

BARCODES, LANDMARKS = "Barcodes.dat", "Landmark_Groundtruth.dat"
ROBOTS = 5
"""Subjects up to this number are robots."""
APART_S = 100_000.0
"""Offset between the times of two robots of one log: more than a day."""

_LOG = logging.getLogger(__name__)
MOST_ROBOTS = 99
_SEEN = "t bar-code range bearing"
_NAME = re.compile(r"Robot([1-9]\d?)_(Measurement|Odometry|Groundtruth)\.dat(\.gz)?$")
_TIME, _ANGLE, _SPEED = 1e12, 1e6, 1e3
_MEASUREMENT = (_TIME, MAX_EXACT_INTEGER, MAX_COORDINATE_M, _ANGLE)


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
            raise RelmapError(f"{shown(path)}: holds no measurements, expected {self.description}")
        subjects, before, drives = _subjects(file_beside(path, BARCODES)), 0, []
        for robot, file in robots.items():
            drive = _Drive.of(robot, file, subjects, before)
            drives.append(drive)
            before += drive.n_measured
        stamps_s = np.concatenate([drive.stamps_s for drive in drives])
        if not len(stamps_s):
            raise RelmapError(f"{shown(path)}: no bar code is that of a landmark, expected some")
        if (np.diff(stamps_s) <= 0).any():
            raise RelmapError(f"{shown(path)}: robots are days apart, expected those of one run")
        row_stamps = np.concatenate([drive.row_stamps_s for drive in drives])
        known = any(drive.counted for drive in drives)
        return ObservationLog(
            points_robot=np.concatenate([drive.points_robot for drive in drives]),
            iteration=np.searchsorted(stamps_s, row_stamps).astype(np.int64),
            rows=np.concatenate([drive.rows for drive in drives]),
            first_iteration=0,
            end_iteration=len(stamps_s),
            ids=np.concatenate([drive.ids for drive in drives]),
            stamps_s=stamps_s,
            odometry=np.concatenate([drive.odometry for drive in drives]) if known else None,
        )


@dataclass(frozen=True, eq=False)
class _Drive:
    """Landmark observations of one robot, in order of time, and its motions."""

    row_stamps_s: Floats
    points_robot: Floats
    ids: Ints
    rows: Ints
    stamps_s: Floats
    odometry: Floats
    counted: bool
    n_measured: int

    @classmethod
    def of(cls, robot: int, file: Path, subjects: dict[int, int], before: int) -> _Drive:
        """Read the files of a robot; `before` is the number of rows of earlier robots."""
        measured = read_rows(file, _MEASUREMENT, "#", "measurement", f"4 numbers: {_SEEN}").values
        measured[:, 1] = [subjects.get(int(code), -1) for code in measured[:, 1]]
        warn_unsorted(file, measured[:, 0], "measurements")
        if unknown := int((measured[:, 1] < 0).sum()):
            _LOG.warning("%s: %d unknown bar codes are left out", shown(file), unknown)
        rows = np.flatnonzero(measured[:, 1] > ROBOTS)
        rows = rows[np.lexsort((rows, measured[rows, 1], measured[rows, 0]))]
        same = (np.diff(measured[rows, :2], axis=0) == 0).all(axis=1)
        rows = np.delete(rows, np.flatnonzero(same) + 1)  # duplicate landmark in one image
        t, subject, range_m, bearing_rad = measured[rows].T
        directions = np.column_stack([np.cos(bearing_rad), np.sin(bearing_rad)])
        stamps_s = np.unique(t)
        motion = _odometry(_file(file.parent, robot, "Odometry"), stamps_s)
        return cls(
            row_stamps_s=_shifted(t, robot),
            points_robot=range_m[:, None] * directions,
            ids=subject.astype(np.int64),
            rows=before + rows,
            stamps_s=_shifted(stamps_s, robot),
            odometry=np.full((len(stamps_s), 4, 4), np.nan) if motion is None else motion,
            counted=motion is not None,
            n_measured=len(measured),
        )


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
    landmarks = read_rows(
        folder / LANDMARKS, [MAX_COORDINATE_M] * 5, "#", "landmark", "5 numbers: subject x y sd sd"
    ).values
    found = [(np.empty(0), np.empty((0, 4, 4)))]
    for robot, measured in _robots(folder).items():
        file = _file(folder, robot, "Groundtruth")
        if file is not None:
            rows = read_rows(measured, _MEASUREMENT, "#", "measurement", f"4 numbers: {_SEEN}")
            images = np.unique(rows.values[:, 0])
            poses = _vicon(file, images)
            there = np.isfinite(poses[:, 0, 0])
            found.append((_shifted(images[there], robot), poses[there]))
    positions = np.column_stack([landmarks[:, 1:3], np.zeros(len(landmarks))])
    stamps_s, poses = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return landmarks[:, 0].astype(np.int64), positions, stamps_s, poses


def _vicon(file: Path, at_s: Floats) -> Floats:
    """Return the poses of a robot (k, 4, 4) at given times; NaN if Vicon did not see it."""
    limits = (_TIME, MAX_COORDINATE_M, MAX_COORDINATE_M, _ANGLE)
    rows = read_rows(file, limits, "#", "pose", "4 numbers: t x y heading").values
    t, first = np.unique(rows[:, 0], return_index=True)
    return poses_at(t, planar_poses(*rows[first, 1:].T), at_s)


def _odometry(file: Path | None, at_s: Floats) -> Floats | None:
    """Return the motions (k, 4, 4) of a robot between images; None without a file."""
    if file is None:
        return None
    limits = (_TIME, _SPEED, _SPEED)
    rows = read_rows(file, limits, "#", "velocity", "3 numbers: t forward angular").values
    warn_unsorted(file, rows[:, 0], "velocities")
    stamps_s, speed, turn = rows[np.argsort(rows[:, 0], kind="stable")].T
    return driven(file, stamps_s, speed, turn, at_s)


def _shifted(stamps_s: Floats, robot: int) -> Floats:
    return stamps_s + (robot - 1) * APART_S


def _subjects(file: Path) -> dict[int, int]:
    """Return the subject of each bar code."""
    rows = read_rows(file, [MAX_EXACT_INTEGER] * 2, "#", "bar code", "2 numbers: subject bar code")
    codes, counts = np.unique(rows.values[:, 1], return_counts=True)
    if (counts > 1).any():
        raise RelmapError(f"{shown(file)}: bar code {codes[counts > 1][0]:.0f} is duplicated")
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
    for end in ("", ".gz"):
        file = folder / f"Robot{robot}_{kind}.dat{end}"
        if os.path.isfile(file):
            return file
    return None
