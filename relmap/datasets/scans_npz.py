"""The project's own log of point scans: ``scans.npz``.

``points`` (n, 3) or, of a 2-D laser, (n, 2), also with a third column of zeros: metres, in the
frame of the sensor, which serves as the robot frame. ``iteration`` (n,): the scan of each point,
from 0; the points of a scan keep their order. Points of a 2-D laser at the origin are beams without
a return. ``stamps_s`` (iterations,): the time of every scan, seconds, ascending; a scan without
points is empty. ``view_rad`` and ``range_m`` (optional numbers): the sensor's horizontal field of
view and range.
"""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats
from relmap.core.stamps import MAX_S
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.foreign import ZIP, foreign_at
from relmap.datasets.headers import file_in
from relmap.datasets.laser import points_of_laser
from relmap.datasets.scans import ScanLog, SensorView, in_time_order, numbers_of
from relmap.datasets.textfile import invalid, quoted, replacing, require_path, unreadable, warn

FILE_NAME = "scans.npz"
"""The log's name in a folder."""

MAX_BYTES = 1 << 29
"""Limit of the unpacked size of a log, 512 MiB."""

_KINDS = {"points": "f", "iteration": "iu", "stamps_s": "fiu"}
_LIMITS = ("view_rad", "range_m")
"""Optional values about the sensor."""
_BEYOND = 1.2
"""Multiple of the stated range above which a point is not noise: the stated range is wrong."""
_OUTSIDE_RAD, _OUTSIDE = 0.1, 0.01
"""Angle beyond the stated view, for noise near the sensor, and the fraction of the points that may
be farther outside: with more, the view is wrong, or the axes of the points are."""
_ENOUGH = 100
"""Minimum number of points in whose order bearings are recognised."""
DAMAGE = (
    *(OSError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error, struct.error),
    *(ValueError, TypeError, LookupError, OverflowError, SyntaxError, tokenize.TokenError),
)
"""Exceptions raised for damaged files."""


class ScansNpz:
    """Reads ``scans.npz``, or a folder that contains it."""

    name = "scans-npz"
    description = f"{FILE_NAME} with points, iteration and stamps_s"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a zip file with arrays, as .npz files are, or a damaged one.

        A saved map, which is also a zip file with arrays, is not recognised.
        """
        file = file_in(path, FILE_NAME)
        return foreign_at(file) == ZIP and not _without_arrays(file)

    def load(self, path: Path) -> ScanLog:
        """Read the log."""
        file = file_in(path, FILE_NAME)
        require_path(file)
        arrays = _read_arrays(file)
        limits = {name: _limit(file, name, arrays[name]) for name in _LIMITS if name in arrays}
        _check_shapes(file, arrays)
        arrays["points"] = arrays["points"].astype(np.float64, copy=False)
        _check_values(file, arrays)
        _check_view(file, arrays["points"], **limits)
        points, iteration, stamps_s = (arrays[name] for name in _KINDS)
        in_time, stamps_s = in_time_order(file, stamps_s.astype(np.float64))
        iteration = np.argsort(in_time)[iteration]
        order = np.argsort(iteration, kind="stable")
        if not points[:, 2:].any():
            points = points[:, :2]
        iteration, points_robot = iteration[order], points[order]
        begins, sensor = np.arange(1, len(stamps_s)), SensorView(**limits)
        scans = np.split(points_robot, np.searchsorted(iteration, begins))
        if points_robot.shape[1] == 2:
            _doubt_axes(file, points_robot, iteration)
            log = points_of_laser(file, scans, stamps_s, sensor)
        else:
            log = ScanLog(3, stamps_s, scans.__getitem__, sensor=sensor)
        return replace(log, numbers=numbers_of(in_time))


def _doubt_axes(file: Path, points: Floats, iteration: NDArray[Any]) -> None:
    """Warn of points (n, 2) that are rather a range and a bearing, which ascends in every scan."""
    steps = np.diff(points, axis=0)[np.diff(iteration) == 0]
    one_way = (steps > 0).all(axis=0) | (steps < 0).all(axis=0)
    found = one_way & (points[:, ::-1] > 0).all(axis=0) & (np.abs(points) <= 360).all(axis=0)
    if len(steps) >= _ENOUGH and found.any():
        which = "bearing and range" if found[0] else "range and bearing"
        warn(file, f"the points look like {which}, expected x (ahead) and y (left), metres")


def write_scans_npz(
    path: Path, scans: list[Floats], stamps_s: Floats, sensor: SensorView | None = None
) -> None:
    """Write scans so that reading them gives the same numbers; the same scans give the same bytes.

    `path`: the file, written atomically; `scans`: list of k (n, 3) or (n, 2), robot frame, metres;
    `stamps_s` (k,); `sensor`: its field of view and range are written if known. Raises
    `RelmapError` if the file cannot be written.
    """
    counts = [len(points) for points in scans]
    iteration = np.repeat(np.arange(len(scans), dtype=np.int64), counts)
    known = {name: getattr(sensor, name, None) for name in _LIMITS}
    limits = {name: np.float64(limit) for name, limit in known.items() if limit is not None}
    arrays: dict[str, Any] = {"points": np.concatenate(scans), "iteration": iteration}
    arrays |= {"stamps_s": stamps_s, **limits}
    with replacing(path) as file:
        np.savez(file, **arrays)


def _read_arrays(file: Path) -> dict[str, NDArray[Any]]:
    """Return the required arrays, with validated types."""
    try:
        with zipfile.ZipFile(file) as archive:
            there = {member.filename for member in archive.infolist()}
            names = [*_KINDS, *(name for name in _LIMITS if f"{name}.npy" in there)]
            missing = [f"{name}.npy" for name in names if f"{name}.npy" not in there]
            if missing:
                raise ValueError(f"a zip archive without {' and '.join(missing)}")
            members = {name: archive.getinfo(f"{name}.npy") for name in names}
            size = sum(member.file_size for member in members.values())
            if size > MAX_BYTES:
                raise ValueError(f"{size} bytes when unpacked, more than {MAX_BYTES}")
            return {name: read_array(archive, member) for name, member in members.items()}
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise unreadable(file, error) from error
    except DAMAGE as error:
        found = foreign_at(file)
        other = found if found != ZIP else None
        reason = quoted(other or str(error) or type(error).__name__)
        raise invalid(file, f"cannot be read: {reason}, expected {ScansNpz.description}") from error


def _without_arrays(file: Path) -> bool:
    """Return whether a zip file is intact and contains no array."""
    try:
        with zipfile.ZipFile(file) as archive:
            return not any(name.endswith(".npy") for name in archive.namelist())
    except DAMAGE:
        return False


def _limit(file: Path, name: str, array: NDArray[Any]) -> float:
    if array.shape == () and array.dtype.kind in "fiu" and 0 < float(array) < np.inf:
        return float(array)
    raise invalid(file, f"array {name}: {array!r}, expected one positive number")


def _check_view(file: Path, points: Floats, view_rad: float = 0.0, range_m: float = np.inf) -> None:
    """Check that a view is an angle, and that it (of a 2-D laser) and a range hold the points."""
    if view_rad > 2 * np.pi + 1e-3:  # rounded
        raise invalid(file, f"array view_rad: {view_rad:g}, expected radians, 2 pi at most")
    outside = np.abs(np.arctan2(points[:, 1], points[:, 0])) > view_rad / 2 + _OUTSIDE_RAD
    share = float(outside.mean())
    if view_rad and not points[:, 2:].any() and share > _OUTSIDE:
        problem = f"array view_rad: {view_rad:g}, but {100 * share:.3g} % of the points are outside"
        raise invalid(file, f"{problem} of it, expected x ahead, in its middle, and y left")
    farthest_m = np.hypot(points[:, 0], points[:, 1]).max()
    if farthest_m > _BEYOND * range_m:
        problem = f"array range_m: {range_m:g}, but there are points up to {farthest_m:.4g} m away"
        raise invalid(file, f"{problem}, expected the greatest range of the sensor, metres")


def _check_shapes(file: Path, arrays: dict[str, NDArray[Any]]) -> None:
    points, iteration, stamps_s = (arrays[name] for name in _KINDS)
    n = len(np.atleast_1d(points))
    is_table = points.ndim == 2 and points.shape[1] in (2, 3) and n > 0
    is_time = stamps_s.ndim == 1 and len(stamps_s) > 0
    for name, fits, expected in (
        ("points", is_table, "floating-point numbers (n, 3) or (n, 2), with at least one point"),
        ("iteration", iteration.shape == (n,), f"whole numbers ({n},), one for each point"),
        ("stamps_s", is_time, "one number for each scan, seconds"),
    ):
        if not fits or arrays[name].dtype.kind not in _KINDS[name]:
            problem = f"array {name}: {arrays[name].dtype} {arrays[name].shape}"
            raise invalid(file, f"{problem}, expected {expected}")


def _check_values(file: Path, arrays: dict[str, NDArray[Any]]) -> None:
    points, iteration, stamps_s = (arrays[name] for name in _KINDS)
    later = np.isfinite(stamps_s)
    order = np.argsort(stamps_s, kind="stable")
    later[order[1:]] &= np.diff(stamps_s[order]) > 0
    last = len(stamps_s) - 1
    near = (np.abs(points) <= MAX_COORDINATE_M).all(axis=1)
    there = (iteration >= 0) & (iteration <= last)
    far = "is not finite or out of range, expected metres; leave out beams without a return"
    again = "is not a later time, expected seconds, a different time for each scan"
    seconds = ~(np.abs(stamps_s) > MAX_S)
    for array, good, problem in (
        ("points", near, far),
        ("iteration", there, f"is not a scan, expected 0 to {last}"),
        ("stamps_s", later, again),
        ("stamps_s", seconds, f"is out of range, expected seconds, at most {MAX_S:g}"),
    ):
        if not good.all():
            raise invalid(file, f"array {array}, row {np.argmin(good)}: {problem}")


def read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Return a member as a numeric array; raises one of `DAMAGE` if it is not one."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{member.filename} is packed in a way that numpy does not use")
    with archive.open(member) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
