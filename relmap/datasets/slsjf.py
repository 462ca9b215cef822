"""The simulation of 8240 steps that comes with I-SLSJF (S. Huang and Z. Wang, UTS Sydney).

A planar robot observes range and bearing of point beacons. ``sensor_data.mat`` has a row per
observation: step (from 1), beacon id, range in metres, bearing in radians (0 ahead, positive to the
left), and three zeros. The exact truth is in the same folder:

* ``store_beaconsTrue.mat``: rows of id, x, y (metres).
* ``store_robotTrue.mat``: x, y (metres) and phi (radians) of a step in each column, from step 1.

``store_robotOdo.mat``, if it exists, has the same form: the path integrated from noisy speed and
turn rate, the odometry. ``parameters.txt``, if it exists, gives the noise: ``sigr = 0.1`` (metres)
of the range and ``sigtheta = (1*pi/180)`` (radians) of the bearing.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.sensor import range_bearing_covariances
from relmap.datasets.assembly import assemble_log, from_polar, id_column, metres_column
from relmap.datasets.base import MAX_ITERATION, ObservationLog
from relmap.datasets.foreign import MATLAB, foreign_at
from relmap.datasets.headers import file_beside, file_in
from relmap.datasets.matfile import read_matrix
from relmap.datasets.number_rows import finite_numbers
from relmap.datasets.odometry import motions
from relmap.datasets.scans import planar_poses
from relmap.datasets.table import MAX_EXACT_INTEGER, Column, Table, checked_table
from relmap.datasets.textfile import invalid, numbered_lines

LOG_FILE = "sensor_data.mat"
BEACONS_FILE = "store_beaconsTrue.mat"
ROBOT_FILE = "store_robotTrue.mat"
ODOMETRY_FILE = "store_robotOdo.mat"
PARAMETERS_FILE = "parameters.txt"

_SIGMA_RANGE = re.compile(r"\bsigr *= *([0-9.]+)")
_SIGMA_BEARING = re.compile(r"\bsigtheta *= *\( *([0-9.]+) *\* *pi */ *180 *\)")
_MAX_ANGLE_RAD = 1e6
_X, _Y = metres_column("x"), metres_column("y")
_OBSERVATION = (
    Column("step", 1, MAX_ITERATION, integer=True),
    id_column("id"),
    metres_column("range_m"),
    Column("bearing_rad", -_MAX_ANGLE_RAD, _MAX_ANGLE_RAD, "radians"),
    *(metres_column(f"unused_{k}") for k in (5, 6, 7)),
)
_BEACON = (Column("id", 0, MAX_EXACT_INTEGER, integer=True), _X, _Y)
_POSE = (_X, _Y, Column("phi", -_MAX_ANGLE_RAD, _MAX_ANGLE_RAD, "radians"))


class SlsjfSimulation:
    """Reads ``sensor_data.mat``, or the folder that contains it."""

    name = "slsjf-sim"
    description = f"the simulation of I-SLSJF as a folder with {LOG_FILE}"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a MATLAB file, or a folder with one named ``sensor_data.mat``."""
        return foreign_at(file_in(path, LOG_FILE)) == MATLAB

    def load(self, path: Path) -> ObservationLog:
        """Read the log: planar; step 1 is iteration 0.

        Bearings may exceed a full turn. Observations with negative range, due to the simulated
        noise, are left out.
        """
        file = file_in(path, LOG_FILE)
        table = _table(file, read_matrix(file, "sensor_data"), _OBSERVATION, "row")
        table = _with_positive_ranges(table)
        table.columns["step"] -= 1
        range_m, bearing_rad = table.columns["range_m"], table.columns["bearing_rad"]
        points = from_polar(range_m, bearing_rad)
        sigmas = _sigmas(file.with_name(PARAMETERS_FILE))
        noise = range_bearing_covariances(points, *sigmas) if sigmas else None
        log = assemble_log(table, "step", points, table.integers("id"), noise)
        odometry, motion = file.with_name(ODOMETRY_FILE), None
        if odometry.is_file():
            poses = np.full((len(log), 4, 4), math.nan)  # NaN beyond the end of the file
            there = _path(odometry)[log.first_iteration : log.end_iteration]
            poses[: len(there)] = there
            motion = motions(poses)
        return replace(log, rows=table.lines[log.rows] - 1, odometry=motion)


def _path(file: Path) -> Floats:
    """Return the pose (4, 4) in each column of a file."""
    robot = _table(file, read_matrix(file, file.stem).T, _POSE, "column").columns
    return planar_poses(robot["x"], robot["y"], robot["phi"])


def _sigmas(file: Path) -> tuple[float, float] | None:
    """Return the noise of range, metres, and bearing, radians; None if not given."""
    if not file.is_file():
        return None
    text = "".join(line for _, line in numbered_lines(file))
    found = _SIGMA_RANGE.search(text), _SIGMA_BEARING.search(text)
    sigmas = finite_numbers(match[1] for match in found if match)
    known = len(sigmas) == 2 and min(sigmas) > 0
    return (sigmas[0], math.radians(sigmas[1])) if known else None


def _table(file: Path, matrix: Floats, columns: tuple[Column, ...], place: str) -> Table:
    """Check a matrix with a row per observation, beacon or pose."""
    if matrix.shape[1] != len(columns):
        expected = f"{len(columns)}: {', '.join(column.name for column in columns)}"
        raise invalid(file, f"{matrix.shape[1]} numbers per {place}, expected {expected}")
    return checked_table(file, columns, matrix, np.arange(1, len(matrix) + 1), place)


def _with_positive_ranges(table: Table) -> Table:
    kept = table.columns["range_m"] >= 0
    if not kept.any():
        table.fail(0, "range_m", "this and every other range is negative, expected metres")
    columns = {name: values[kept] for name, values in table.columns.items()}
    return replace(table, columns=columns, lines=table.lines[kept])


def is_ground_truth(path: Path) -> bool:
    """Return whether a folder contains the true beacons, or a path has the name of a truth file."""
    return path.name in (BEACONS_FILE, ROBOT_FILE) or os.path.isfile(path / BEACONS_FILE)


def read_ground_truth(path: Path | str) -> tuple[Ints, Floats, Floats]:
    """Read the exact truth of the simulation.

    `path`: the folder, or any file in it. Returns `landmark_ids` (m,): ids of all beacons,
    including those never seen, `positions` (m, 3), map frame, metres: z = 0 and `poses` (k, 4, 4):
    T_map_robot of every iteration, and of the step after the last. Raises `RelmapError` if a file
    is missing, or violates the format.
    """
    file = file_beside(path, BEACONS_FILE)
    beacons = _table(file, read_matrix(file, file.stem), _BEACON, "row").columns
    positions = np.column_stack([beacons["x"], beacons["y"], np.zeros(len(beacons["x"]))])
    return beacons["id"].astype(np.int64), positions, _path(file_beside(path, ROBOT_FILE))
