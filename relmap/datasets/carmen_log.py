"""2-D laser scans in the two kinds of CARMEN text log, ``.log`` or ``.log.gz``.

* ``FLASER n r1..rn x y theta odom_x odom_y odom_theta t host t_logger``: the beams spread over 180
  degrees, from right to left. The robot frame is the LASER's: x, y, theta is its pose, after SLAM
  the corrected one. An even n leaves out the last beam, at 90 degrees to the left.
* ``ROBOTLASER1 type start_angle fov resolution max_range accuracy remission n r1..rn m v1..vm
  laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv 3 safeties t host t_logger``. The
  robot frame is the robot's. A graph log has ``VERTEX2 id x y theta``, the optimised pose, before
  each scan.

The stamp is t, the first of the two times. CARMEN: M. Montemerlo, N. Roy and S. Thrun, IROS 2003.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.number_rows import NumberRows, parse_number
from relmap.datasets.scans import (
    ScanLog,
    in_time_order,
    laser_scans,
    planar_poses,
    require_memory,
)
from relmap.datasets.textfile import numbered_lines, quoted, shown

FULL_SCALES_M = (32.767, 51.16, 81.91)
"""A SICK LMS writes what is too far, and other failures, as the last steps of its scale."""
ERROR_STEPS_M = 0.12

_HALLMARKS = {"FLASER", "ROBOTLASER1", "PARAM", "ODOM", "VERTEX2", "RLASER", "SYNC", "NEFF"}
_MOST_BEAMS = 10_000
_DIGITS = re.compile(r"[0-9]{1,5}")
_VERTEX = "VERTEX2 id x y theta"
_FLASER = "FLASER n r1..rn x y theta odom_x odom_y odom_theta t host t"
_ROBOTLASER = "ROBOTLASER1 7 numbers n r1..rn m v1..vm 11 numbers t host t"


@dataclass(frozen=True, eq=False)
class _Scan:
    """What one line holds; `limit_m` is what it says of the sensor's maximum."""

    ranges_m: NDArray[np.float64]
    bearings_rad: NDArray[np.float64]
    pose: list[float]
    T_robot_laser: list[float]
    stamp_s: float
    limit_m: float


class CarmenLog:
    """Reads one log."""

    name = "carmen-log"
    description = "a CARMEN log with FLASER or ROBOTLASER1 lines"

    def recognises(self, path: Path) -> bool:
        """Tell whether the first line that is no comment begins as those of CARMEN do."""
        if os.path.isdir(path):
            return False
        try:
            for _, cells in _lines(path):
                return cells[0] in _HALLMARKS
        except RelmapError:
            pass
        return False

    def load(self, path: Path) -> ScanLog:
        """Read the log: planar scans, beams in order, without those that did not return.

        Of ``FLASER`` and ``ROBOTLASER1`` the kind is read that comes first.

        Raises
        ------
        RelmapError
            Where a line is not what the format promises, or the log holds no scan.
        """
        scans: list[_Scan] = []
        vertices, beams = NumberRows(path, 3), 0
        kinds = {"FLASER": _flaser, "ROBOTLASER1": _robotlaser}
        for number, cells in _lines(path):
            if cells[0] in kinds:
                kinds = {cells[0]: kinds[cells[0]]}
                scans.append(kinds[cells[0]](path, number, cells))
                beams += len(scans[-1].ranges_m)
                require_memory(f"{shown(path)}: line {number}", len(scans), beams)
            elif cells[0] == "VERTEX2":
                vertices.add(_numbers(path, number, cells[2:], 3, _VERTEX), number)
        if not scans:
            raise RelmapError(f"{shown(path)}: holds no scan, expected {self.description}")
        return _log(path, scans, vertices.values)


def _log(path: Path, scans: list[_Scan], vertices: NDArray[np.float64]) -> ScanLog:
    given = len(vertices) == len(scans)
    x, y, yaw = (vertices if given else np.array([scan.pose for scan in scans])).T
    order, stamps_s = in_time_order(path, np.array([scan.stamp_s for scan in scans]))
    scans = [scans[index] for index in order]
    return laser_scans(
        path,
        [scan.ranges_m for scan in scans],
        [scan.bearings_rad for scan in scans],
        _limit(scans),
        np.array([scan.T_robot_laser for scan in scans]),
        stamps_s,
        planar_poses(x, y, yaw)[order],
    )


def _limit(scans: list[_Scan]) -> float:
    """Return the range that says there was no return."""
    largest = max(float(scan.ranges_m.max()) for scan in scans)
    tops = [scale - ERROR_STEPS_M for scale in FULL_SCALES_M]
    full = [top for top in tops if top <= largest <= top + ERROR_STEPS_M]
    return min(full + [scan.limit_m for scan in scans])


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and words of every line that is neither empty nor a comment."""
    for number, line in numbered_lines(path):
        cells = line.split()
        if cells and not cells[0].startswith("#"):
            yield number, cells


def _flaser(path: Path, number: int, cells: list[str]) -> _Scan:
    n = _count(path, number, cells, 1, _FLASER)
    if len(cells) != n + 11:
        raise _bad(path, number, cells, _FLASER)
    values = _numbers(path, number, [*cells[2:-5], cells[-3]], n + 5, _FLASER)
    step = math.pi / (n if n % 2 == 0 else max(n - 1, 1))
    return _Scan(
        _ranges(path, number, values[:n]),
        -math.pi / 2 + step * np.arange(n, dtype=np.float64),
        values[n : n + 3],
        [0.0, 0.0, 0.0],
        values[-1],
        math.inf,
    )


def _robotlaser(path: Path, number: int, cells: list[str]) -> _Scan:
    n = _count(path, number, cells, 8, _ROBOTLASER)
    m = _count(path, number, cells, 9 + n, _ROBOTLASER, least=0)
    if len(cells) != n + m + 24:
        raise _bad(path, number, cells, _ROBOTLASER)
    values = _numbers(path, number, cells[1:-2], n + m + 21, _ROBOTLASER)
    laser, robot = values[n + m + 9 : n + m + 12], values[n + m + 12 : n + m + 15]
    return _Scan(
        _ranges(path, number, values[8 : n + 8]),
        values[1] + values[3] * np.arange(n, dtype=np.float64),
        robot,
        _in_frame(laser, robot),
        values[-1],
        values[4],
    )


def _ranges(path: Path, number: int, values: list[float]) -> NDArray[np.float64]:
    ranges = np.array(values)
    wrong = ranges > MAX_COORDINATE_M
    if wrong.any():
        beam = int(np.argmax(wrong))
        raise RelmapError(
            f"{shown(path)}: line {number}: the range of beam {beam} is {values[beam]:.10g}, "
            f"expected metres up to {MAX_COORDINATE_M:g}"
        )
    return ranges


def _in_frame(laser: list[float], robot: list[float]) -> list[float]:
    """Return the pose x, y, yaw of the laser in the robot's frame; both are given in a third."""
    dx, dy = laser[0] - robot[0], laser[1] - robot[1]
    c, s = math.cos(robot[2]), math.sin(robot[2])
    return [c * dx + s * dy, c * dy - s * dx, laser[2] - robot[2]]


def _count(
    path: Path, number: int, cells: list[str], at: int, expected: str, least: int = 1
) -> int:
    cell = cells[at] if at < len(cells) else ""
    count = int(cell) if _DIGITS.fullmatch(cell) else -1
    if not least <= count <= _MOST_BEAMS:
        raise _bad(path, number, cells, expected)
    return count


def _numbers(path: Path, number: int, cells: list[str], count: int, expected: str) -> list[float]:
    try:
        values = [parse_number(cell) for cell in cells]
    except ValueError as error:
        raise _bad(path, number, [str(error)], expected) from error
    if len(values) != count or not all(map(math.isfinite, values)):
        raise _bad(path, number, cells, expected)
    return values


def _bad(path: Path, number: int, cells: list[str], expected: str) -> RelmapError:
    found = quoted(" ".join(cells[:8]))
    return RelmapError(f"{shown(path)}: line {number}: {found}, expected {expected}")
