"""Victoria Park, Sydney: trees seen by the laser on a pickup truck (Guivant and Nebot, ACFR).

``trees_per_scan.csv.gz``: header ``scan,t_ms,range_m,bearing_rad,diameter_m``; bearing 0 at the
laser's right, pi/2 straight ahead. The robot frame is the LASER's (x ahead, y left), 3.78 m ahead
of the rear axle's centre and 0.50 m to its left. Three files beside it are read if they exist:

* ``VictoriaParkSinSincronizar.mat``: ``TLsr`` (1, scans), the time of every scan, seconds.
* ``data_sensor_clean_clean.mat``: t ms, range, bearing, x_est, y_est, tree id, associated by
  S. Huang and Z. Wang (UTS) with an EKF. This is not a truth but a result of another program.
* ``aa3_dr.mat``: ``time`` (ms), ``speed`` (m/s) of the left rear wheel and ``steering`` (rad, to
  the left): the odometry. By the published model of the car, the centre of the rear axle moves at v
  / (1 - tan(steering) H / L) and turns by tan(steering) / L per metre.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.datasets.assembly import assemble_log, iteration_column
from relmap.datasets.base import ObservationLog
from relmap.datasets.headers import TABLES, columns_of, file_beside, only_one, tables_with
from relmap.datasets.matfile import read_matrix
from relmap.datasets.odometry import driven, moved_frame
from relmap.datasets.scans import planar_poses
from relmap.datasets.table import Column, Table, header_text, read_table
from relmap.datasets.textfile import invalid

CLOCK_FILE = "VictoriaParkSinSincronizar.mat"
"""File with the time of every scan, including those without a tree."""

ASSOCIATION_FILE = "data_sensor_clean_clean.mat"
"""File with tree numbers."""

WHEEL_FILE = "aa3_dr.mat"
"""File with speed and steering."""

WHEELBASE_M, WHEEL_M = 2.83, 0.76
"""L, between the axles, and H, from the centre of the rear axle to the measured wheel."""
LASER_AHEAD_M, LASER_LEFT_M = 3.78, 0.50
"""Position of the laser, from the centre of the rear axle."""

_COLUMNS = (
    iteration_column("scan"),
    Column("t_ms", 0, 1e12, "milliseconds"),
    Column("range_m", 0.0, 1000.0, "metres"),
    Column("bearing_rad", -math.tau, math.tau, "radians"),
    Column("diameter_m", 0.0, 1000.0, "metres"),
)
_HALLMARK = frozenset({"scan", "range_m", "bearing_rad"})

_SAME_SCAN_S = 5e-4
_SAME_TREE_M = 0.05
_SCAN_APART_M = 10_000.0


class VictoriaPark:
    """Reads ``trees_per_scan.csv.gz``, or the folder that contains it."""

    name = "victoria-park"
    description = f"Victoria Park's trees with the header {header_text(_COLUMNS)}"

    def recognises(self, path: Path) -> bool:
        """Return whether the header is that of Victoria Park's trees, or almost."""
        if os.path.isdir(path):
            return bool(tables_with(path, _HALLMARK))
        found = columns_of(path)
        return "bearing_rad" in found or found >= {"scan", "t_ms"}

    def load(self, path: Path) -> ObservationLog:
        """Read the log: planar, laser frame, one iteration per scan.

        Trees have ids if the association file is in the same folder, -1 for missing trees, and the
        log has odometry, of the laser, if the file of speed and steering is. Without the clock file
        the log ends with the last scan that has a tree, and the time of a scan without one is
        interpolated.
        """
        file = only_one(path, tables_with(path, _HALLMARK), "Victoria Park log", TABLES)
        table = read_table(file, _COLUMNS)
        points_robot = _points(table.columns["range_m"], table.columns["bearing_rad"])
        log = assemble_log(table, "scan", points_robot, None)
        log = _with_clock(table, log, file.with_name(CLOCK_FILE))
        wheel, association = file.with_name(WHEEL_FILE), file.with_name(ASSOCIATION_FILE)
        if os.path.isfile(wheel):
            log = replace(log, odometry=_odometry(log, wheel))
        if not os.path.isfile(association):
            return log
        return replace(log, ids=_match_ids(log, association))


def is_reference(path: Path) -> bool:
    """Return whether a folder contains the association file, or a path has its name."""
    return path.name == ASSOCIATION_FILE or os.path.isfile(path / ASSOCIATION_FILE)


def read_reference_map(path: Path | str) -> tuple[Ints, Floats]:
    """Read the tree positions from the association file: EKF estimates, not a surveyed truth.

    The file contains the filter's estimate at every observation, which changes by 0.45 m (median)
    and up to 3.5 m; the last one of each tree best fits the observed distances and is returned.

    `path`: the folder, or any file in it. Returns `ids` (m,), ascending. `positions` (m, 3),
    metres: z = 0; x ahead and y left of the rear axle's centre at the start. Raises `RelmapError`
    if the association file is missing or damaged.
    """
    rows = _read_association(file_beside(path, ASSOCIATION_FILE))
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    rows = rows[rows[:, 5] >= 0]
    ids, last_from_end = np.unique(rows[::-1, 5], return_index=True)
    positions = np.zeros((len(ids), 3))
    positions[:, :2] = rows[::-1][last_from_end, 3:5]
    return ids.astype(np.int64), positions


def _points(range_m: Floats, bearing_rad: Floats) -> Floats:
    """Return the points, (n, 2), laser frame, metres."""
    ahead, left = np.sin(bearing_rad), -np.cos(bearing_rad)
    return np.asarray(range_m[:, None] * np.column_stack([ahead, left]))


def _with_clock(table: Table, log: ObservationLog, clock: Path) -> ObservationLog:
    """Add the stamps to the log, and empty scans at its ends according to the clock."""
    row_stamps = table.columns["t_ms"][log.rows] / 1000
    scans, first_rows, counts = np.unique(log.iteration, return_index=True, return_counts=True)
    scan_stamps = row_stamps[first_rows]
    wrong = row_stamps != np.repeat(scan_stamps, counts)
    wrong[first_rows[1:]] |= np.diff(scan_stamps) <= 0
    if wrong.any():
        problem = "differs within a scan or does not increase, expected the time of each scan"
        table.fail(int(log.rows[np.argmax(wrong)]), "t_ms", problem)
    if not os.path.isfile(clock):
        every_scan = np.arange(log.first_iteration, log.end_iteration)
        return replace(log, stamps_s=np.interp(every_scan, scans, scan_stamps))
    stamps_s = read_matrix(clock, "TLsr").ravel()
    if not np.isfinite(stamps_s).all() or (np.diff(stamps_s) <= 0).any():
        raise invalid(clock, "field TLsr: does not increase, expected seconds")
    late = scans >= len(stamps_s)
    late[~late] = np.abs(stamps_s[scans[~late]] - scan_stamps[~late]) > _SAME_SCAN_S
    if late.any():
        row = int(log.rows[first_rows[np.argmax(late)]])
        table.fail(row, "t_ms", f"expected the scan's time as in {clock.name}, field TLsr")
    return replace(log, stamps_s=stamps_s, first_iteration=0, end_iteration=len(stamps_s))


def _match_ids(log: ObservationLog, file: Path) -> Ints:
    """Return each observation's tree number, by time stamp and nearest point; -1 if it has none."""
    rows = _read_association(file)
    assert log.stamps_s is not None
    stamps_s, middles_s = rows[:, 0] / 1000, (log.stamps_s[1:] + log.stamps_s[:-1]) / 2
    scan = np.searchsorted(middles_s, stamps_s)
    same = np.abs(log.stamps_s[scan] - stamps_s) < _SAME_SCAN_S
    rows, scan = rows[same], scan[same] + log.first_iteration
    theirs = np.column_stack([scan * _SCAN_APART_M, _points(rows[:, 1], rows[:, 2])])
    ours = np.column_stack([log.iteration * _SCAN_APART_M, log.points_robot])
    distance, match = cKDTree(ours).query(theirs, distance_upper_bound=_SAME_TREE_M)
    found = np.isfinite(distance)
    matched = np.asarray(match)[found]
    if len(matched) == 0 or len(np.unique(matched)) < len(matched):
        there = f"{len(matched)} of {len(same)} rows found there, not each once"
        problem = f"does not fit the trees beside it ({there})"
        raise invalid(file, f"{problem}, expected detections of the same scans")
    ids = np.full(len(log.iteration), -1, dtype=np.int64)
    ids[matched] = rows[found, 5].astype(np.int64)
    return ids


def _odometry(log: ObservationLog, file: Path) -> Floats:
    """Return the motions of the laser (k, 4, 4)."""
    names = ("time", "speed", "steering")
    time_ms, speed, steering = (read_matrix(file, name).ravel() for name in names)
    alike = len(time_ms) == len(speed) == len(steering) > 1
    turned = alike and bool((np.abs(steering) < math.pi / 3).all())
    if not turned or not (np.diff(time_ms) > 0).all() or not (np.abs(speed) < 100).all():
        problem = f"fields {', '.join(names)} differ in length or are out of range"
        expected = "increasing milliseconds, metres per second and radians"
        raise invalid(file, f"{problem}, expected {expected}")
    assert log.stamps_s is not None
    curvature = np.tan(steering) / WHEELBASE_M
    centre_m_s = speed / (1 - curvature * WHEEL_M)
    moved = driven(file, time_ms / 1000, centre_m_s, centre_m_s * curvature, log.stamps_s)
    laser = planar_poses(*np.array([[LASER_AHEAD_M], [LASER_LEFT_M], [0.0]]))
    return moved_frame(moved, laser[0])


def _read_association(file: Path) -> Floats:
    """Return t ms, range m, bearing rad, x m, y m, id, as (n, 6)."""
    rows = read_matrix(file, file.stem)
    good = rows.shape[1] == 6 and bool(np.isfinite(rows).all())
    if not good or (np.abs(rows) > 1e12).any() or (rows[:, 5] != np.rint(rows[:, 5])).any():
        problem = f"field {file.stem}: is not finite rows of 6 with an integer id"
        raise invalid(file, f"{problem}, expected t_ms, range_m, bearing_rad, x_est_m, y_est_m, id")
    return rows
