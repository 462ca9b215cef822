"""2-D laser scans of MRPT's simulator with the exact path, as ``*.scans.csv.gz``.

Header ``t_s,gt_x,gt_y,gt_theta,odo_dx,odo_dy,odo_dtheta,r0,r1,...``: one row per scan, beams from
-90 degrees (right) to +90 degrees (left); ``odo_...`` is the odometry's motion, in the robot's
frame, that FOLLOWS the scan. A comment above describes the sensor::

    # ... ; sensor on robot x=0.2 y=0 z=0.1 yaw=0 ; ..., max range 80 m
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.headers import TABLES, columns_of, only_one, tables_with
from relmap.datasets.laser import Beams, laser_scans, require_memory
from relmap.datasets.number_rows import finite_numbers
from relmap.datasets.odometry import motions, path_of
from relmap.datasets.scans import ScanLog, in_time_order, numbers_of, planar_poses
from relmap.datasets.table import Column, Table, read_table
from relmap.datasets.textfile import invalid, shown

_HALLMARK = frozenset({"t_s", "gt_theta", "r0"})
_TRUE = ("gt_x", "gt_y", "gt_theta")
_STEP = ("odo_dx", "odo_dy", "odo_dtheta")
_BEAM = re.compile(r"r(0|[1-9]\d{0,4})$")
_SENSOR = re.compile(r"sensor on robot x=(\S+) y=(\S+) z=\S+ yaw=(\S+)")
_MAXIMUM = re.compile(r"max range (\S+) m\b")


class MrptLaser:
    """Reads one log, or a folder with exactly one."""

    name = "mrpt-laser2d"
    description = "MRPT's laser scans with the header t_s,gt_x,...,r0,r1,..."

    def recognises(self, path: Path) -> bool:
        """Return whether the header is that of such a log."""
        return bool(tables_with(path, _HALLMARK))

    def load(self, path: Path) -> ScanLog:
        """Read the log: planar scans in the robot's frame; the reference poses are exact."""
        file = only_one(path, tables_with(path, _HALLMARK), "MRPT laser log", TABLES)
        beams = sum(bool(_BEAM.match(name)) for name in columns_of(file))
        far = MAX_COORDINATE_M
        columns = [
            Column("t_s", 0.0, 1e12, "seconds"),
            *(Column(name, -far, far, "metres or radians") for name in (*_TRUE, *_STEP)),
            *(Column(f"r{k}", -far, far, "metres") for k in range(beams)),
        ]
        table = read_table(file, columns)
        require_memory(shown(file), len(table.lines), len(table.lines) * beams)
        order, stamps_s = in_time_order(file, table.columns["t_s"])
        sensor, limit_m = _sensor(table)
        ranges = np.column_stack([table.columns[f"r{k}"] for k in range(beams)])[order]
        bearing = np.linspace(-math.pi / 2, math.pi / 2, beams)
        poses = planar_poses(*(table.columns[name] for name in _TRUE))
        scans = [Beams(scan_m, bearing, sensor) for scan_m in ranges]
        log = laser_scans(file, scans, limit_m, stamps_s, poses[order])
        steps = planar_poses(*(table.columns[name] for name in _STEP))
        odometry = motions(path_of(np.roll(steps, 1, axis=0))[order])
        return replace(log, odometry=odometry, numbers=numbers_of(order))


def _sensor(table: Table) -> tuple[list[float], float]:
    """Return the pose x, y, yaw of the sensor on the robot, and its maximum range, metres."""
    text = "\n".join(table.comments)
    pose, maximum = _SENSOR.search(text), _MAXIMUM.search(text)
    if pose and maximum:
        numbers = finite_numbers((*pose.groups(), maximum[1]))
        if numbers and numbers[-1] > 0:
            return numbers[:3], numbers[3]
    expected = "'# sensor on robot x=0 y=0 z=0 yaw=0 ; max range 80 m'"
    raise invalid(table.path, f"comments above the header: no usable sensor, expected {expected}")
