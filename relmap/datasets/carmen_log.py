"""2-D laser scans in the two kinds of CARMEN text log, ``.log`` or ``.log.gz``.

* ``FLASER n r1..rn x y theta odom_x odom_y odom_theta t host t_logger``: the beams spread over 180
  degrees, from right to left, or over 100 degrees if there are 400 or 401, as a SICK LMS has. The
  robot frame is the LASER's: x, y, theta is its pose, after SLAM the corrected one. With even n,
  the last beam on the left is missing.
* ``ROBOTLASER1 type start_angle fov resolution max_range accuracy remission n r1..rn m v1..vm
  laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv 3 safeties t host t_logger``. The
  robot frame is the robot's. A graph log has ``VERTEX2 id x y theta``, the optimised pose, before
  each scan.

Beside them ``ODOM x y theta tv rv accel t host t_logger``, and ``PARAM robot_frontlaser_offset``,
the distance of the laser ahead. The stamp is t, the first of the two times.
`relmap.datasets.carmen_odometry` determines which pose, if any, is odometry. CARMEN: M. Montemerlo,
N. Roy and S. Thrun, IROS 2003.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.carmen_odometry import Hints, odometry_of
from relmap.datasets.headers import members_of
from relmap.datasets.laser import Beams, laser_scans, require_memory
from relmap.datasets.number_rows import NumberRows, finite_numbers
from relmap.datasets.scans import ScanLog, in_time_order, numbers_of, planar_poses
from relmap.datasets.textfile import invalid, numbered_lines, quoted, shown, warn

FULL_SCALES_M = (32.767, 51.16, 81.91)
"""A SICK LMS reports missing returns and other failures as the last steps of its scale."""
ERROR_STEPS_M = 0.12

VIEWS_DEG = {401: 100.0}
"""Field of view of a ``FLASER`` line by the odd number of beams, if it is not `USUAL_DEG`."""
USUAL_DEG, FINEST_DEG = 180.0, 0.25
"""The usual field of view, and the resolution of which that of a SICK LMS is a multiple."""

_HALLMARKS = {"FLASER", "ROBOTLASER1", "PARAM", "ODOM", "VERTEX2", "RLASER", "SYNC", "NEFF"}
_MOST_BEAMS = 10_000
_DIGITS = re.compile(r"[0-9]{1,5}")
_FORMS = {
    "VERTEX2": "VERTEX2 id x y theta",
    "FLASER": "FLASER n r1..rn x y theta odom_x odom_y odom_theta t host t",
    "ROBOTLASER1": "ROBOTLASER1 7 numbers n r1..rn m v1..vm 11 numbers t host t",
}
NO_RETURN = "; a beam without a return has the range 0 or the maximum range of the laser"
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class _Scan(Beams):
    """Content of one line; `limit_m` is its statement of the sensor's maximum range.

    Poses are x, y, yaw; `counted` is the robot pose in the odometry fields, and `speeds` are the
    forward and angular speed, if any.
    """

    pose: list[float]
    counted: list[float]
    stamp_s: float
    limit_m: float = math.inf
    speeds: Sequence[float] = ()


def carmen_logs(folder: Path) -> list[Path]:
    """Return the logs in a folder."""
    files = members_of(folder, (".log", ".log.gz"))
    return [file for file in files if CarmenLog().recognises(file)]


class CarmenLog:
    """Reads one log."""

    name = "carmen-log"
    description = "a CARMEN log with FLASER or ROBOTLASER1 lines"

    def recognises(self, path: Path) -> bool:
        """Return whether the first line other than a comment begins like a CARMEN line."""
        with suppress(RelmapError):
            return any(line.cells[0] in _HALLMARKS for line in islice(_lines(path), 1))
        return False

    def load(self, path: Path) -> ScanLog:
        """Read the log: planar scans, beams in order, without those that did not return.

        If there are both ``FLASER`` and ``ROBOTLASER1`` lines, the kind that comes first is read.
        """
        scans: list[_Scan] = []
        vertices, beams, hints = NumberRows(path, 3), 0, Hints()
        kinds = {"FLASER": _flaser, "ROBOTLASER1": _robotlaser}
        for line in _lines(path):
            kind = line.cells[0]
            if kind in kinds:
                kinds = {kind: kinds[kind]}
                scans.append(kinds[kind](line))
                beams += len(scans[-1].ranges_m)
                require_memory(f"{shown(path)}: line {line.number}", len(scans), beams)
            elif kind == "VERTEX2":
                vertices.add(line.numbers(line.cells[2:], 3, 5), line.number)
            else:
                hints.see(line.cells)
        if not scans:
            raise invalid(path, f"holds no scan, expected {self.description}")
        return _log(path, scans, vertices.values, hints)


def _log(path: Path, scans: list[_Scan], vertices: Floats, hints: Hints) -> ScanLog:
    given = len(vertices) == len(scans)
    poses = planar_poses(*(vertices if given else np.array([scan.pose for scan in scans])).T)
    order, stamps_s = in_time_order(path, np.array([scan.stamp_s for scan in scans]))
    scans, poses = [scans[index] for index in order], poses[order]
    counted = planar_poses(*np.array([scan.counted for scan in scans]).T)
    hints.see_speeds(speed for scan in scans for speed in scan.speeds)
    # The frame of FLASER lines is that of the laser; they have no speeds.
    odometry, reason = odometry_of(poses, counted, hints, of_laser=not scans[0].speeds)
    if not scans[0].speeds:
        _warn_of_view(path, len(scans[0].ranges_m))
    largest = max(float(scan.ranges_m.max()) for scan in scans)
    tops = [scale - ERROR_STEPS_M for scale in FULL_SCALES_M]
    full = [top for top in tops if top <= largest <= top + ERROR_STEPS_M]
    limit_m = min(full + [scan.limit_m for scan in scans])
    log = laser_scans(path, scans, limit_m, stamps_s, poses)
    return replace(log, odometry=odometry, no_odometry=reason, numbers=numbers_of(order))


def _lines(path: Path) -> Iterator[_Line]:
    """Yield every line that is neither empty nor a comment."""
    for number, text in numbered_lines(path):
        cells = text.split()
        if cells and not cells[0].startswith("#"):
            yield _Line(path, number, cells)


def _warn_of_view(path: Path, n: int) -> None:
    """Warn if a number of beams is not that of a laser with the usual field of view."""
    steps = n - n % 2
    if steps and steps + 1 not in VIEWS_DEG and USUAL_DEG / FINEST_DEG % steps:
        assumed = f"{n} beams are taken to cover {USUAL_DEG:.0f} degrees"
        advice = "otherwise give ROBOTLASER1 lines or scans.npz"
        warn(path, f"FLASER lines do not give the field of view: {assumed}; {advice}")


def _flaser(line: _Line) -> _Scan:
    n = line.count(1)
    values = line.numbers(line.cells[2:-2], n + 7, n + 11, slice(n))
    steps = max(n - n % 2, 1)
    view_rad = math.radians(VIEWS_DEG.get(steps + 1, USUAL_DEG))
    return _Scan(
        line.ranges(values[:n]),
        -view_rad / 2 + view_rad / steps * np.arange(n, dtype=np.float64),
        [0.0, 0.0, 0.0],
        values[n : n + 3],
        values[n + 3 : n + 6],
        values[-1],
    )


def _robotlaser(line: _Line) -> _Scan:
    n = line.count(8)
    m = line.count(9 + n, least=0)
    values = line.numbers(line.cells[1:-2], n + m + 21, n + m + 24, slice(8, 8 + n))
    bearings_rad = values[1] + values[3] * np.arange(n, dtype=np.float64)
    if np.abs(bearings_rad).max() > math.tau:
        raise line.wrong(line.cells, ": start angle and resolution are in radians")
    laser, robot = values[n + m + 9 : n + m + 12], values[n + m + 12 : n + m + 15]
    return _Scan(
        line.ranges(values[8 : n + 8]),
        bearings_rad,
        _in_frame(laser, robot),
        robot,
        robot,
        values[-1],
        values[4] if values[4] > 0 else math.inf,
        values[n + m + 15 : n + m + 17],
    )


def _in_frame(laser: list[float], robot: list[float]) -> list[float]:
    """Return the pose x, y, yaw of the laser in the robot frame, given both in a third frame."""
    dx, dy = laser[0] - robot[0], laser[1] - robot[1]
    c, s = math.cos(robot[2]), math.sin(robot[2])
    return [c * dx + s * dy, c * dy - s * dx, laser[2] - robot[2]]


@dataclass(frozen=True)
class _Line:
    """The words of one line; its methods raise RelmapError with the location of errors."""

    path: Path
    number: int
    cells: list[str]

    def count(self, at: int, least: int = 1) -> int:
        """Return the number of beams or remissions in a cell."""
        if at >= len(self.cells):
            raise self.wrong(self.cells, f": cut off after field {len(self.cells)}")
        cell = self.cells[at]
        count = int(cell) if _DIGITS.fullmatch(cell) else -1
        if not least <= count <= _MOST_BEAMS:
            raise self.wrong(self.cells)
        return count

    def numbers(
        self, cells: list[str], count: int, words: int, ranges: slice = slice(0)
    ) -> list[float]:
        """Return `count` finite numbers, those in `ranges` ranges, of a line of `words` words."""
        values = finite_numbers(cells)
        if len(self.cells) < words:
            raise self.wrong(self.cells, f": cut off after {len(self.cells)} of {words} fields")
        if len(values) != count or len(self.cells) != words:
            culprits = [cell for cell in cells if not finite_numbers([cell])][:1]
            if len(self.cells) != words or not culprits:
                raise self.wrong(self.cells)
            no_return = culprits[0] in cells[ranges] and _NOT_FINITE.fullmatch(culprits[0])
            raise self.wrong(culprits, NO_RETURN if no_return else "")
        return values

    def ranges(self, values: list[float]) -> Floats:
        """Return the ranges of a scan, metres."""
        ranges = np.array(values)
        wrong = ranges > MAX_COORDINATE_M
        if wrong.any():
            beam = int(np.argmax(wrong))
            problem = f"line {self.number}: the range of beam {beam} is {values[beam]:.10g}"
            raise invalid(self.path, f"{problem}, expected metres up to {MAX_COORDINATE_M:g}")
        return ranges

    def wrong(self, cells: list[str], why: str = "") -> RelmapError:
        found, expected = quoted(" ".join(cells[:8])), _FORMS[self.cells[0]]
        where = f"{shown(self.path)}: line {self.number}"
        return RelmapError(f"{where}: {found}, expected {expected}{why}")
