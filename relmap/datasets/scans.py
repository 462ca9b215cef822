"""Logs of point scans, and the interface of their readers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.motions import rotations, transforms
from relmap.core.shown import Brief
from relmap.core.stamps import MAX_S
from relmap.datasets.base import common_range, some_of
from relmap.datasets.textfile import invalid, warn

_ROUNDING = 1e-2
"""Tolerance of products of the rows of a rotation, for rounded files."""


@dataclass(frozen=True, eq=False, repr=False)
class PointScan(Brief):
    """The points of one scan.

    Attributes
    ----------
    iteration : int
        Number of the scan in the log.
    points_robot : (n, 2) or (n, 3) float64, robot frame, metres
        For a 2-D laser two columns, the beams with a return, from right to left.
    stamp_s : float
        Time, seconds; the iteration number if the log has no clock.
    T_reference_robot : (4, 4) float64 or None
        The reference pose given by the log, if any.
    odometry : (4, 4) float64 or None
        Motion since the previous scan: the pose of the robot in its previous frame. NaN if unknown,
        None if the log has no odometry.
    """

    iteration: int
    points_robot: Floats
    stamp_s: float
    T_reference_robot: Floats | None
    odometry: Floats | None = None


@dataclass(frozen=True)
class SensorView:
    """Known properties of the sensor of a log, the same for all scans.

    Attributes
    ----------
    view_rad : float or None
        Horizontal field of view, radians, centred ahead of it.
    range_m : float or None
        Greatest horizontal range, metres.
    x_m, y_m, yaw_rad : float
        Pose on the robot.
    """

    view_rad: float | None = None
    range_m: float | None = None
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class ScanLog(Brief):
    """The point scans of a whole run; the points of a scan may be read lazily.

    Attributes
    ----------
    dimension : int
        2 for scans of a 2-D laser, else 3.
    stamps_s : (k,) float64, ascending
        Time of each scan, seconds; iteration numbers if the log has no clock.
    points_of : callable
        Returns the points (n, dimension) of the scan at an index in range(k); robot frame, metres.
        It raises RelmapError if a file of that scan is damaged.
    poses : (k, 4, 4) float64 or None
        T_reference_robot of each scan: the reference poses of the log, exact or not;
        NaN if unknown.
    first_iteration : int
        Number of the first scan.
    sensor : SensorView
    odometry : (k, 4, 4) float64 or None
        Motion from the previous scan to each one, see `PointScan`; that of the first is not used.
    no_odometry : str
        Why the log's odometry fields are not used as odometry, if so.
    numbers : (k,) int64 or None
        Number of each scan in the source, if they were renumbered in order of time.
    """

    dimension: int
    stamps_s: Floats
    points_of: Callable[[int], Floats]
    poses: Floats | None = None
    first_iteration: int = 0
    sensor: SensorView = SensorView()
    odometry: Floats | None = None
    no_odometry: str = ""
    numbers: Ints | None = None

    def __len__(self) -> int:
        """Return the number of scans, empty ones included."""
        return len(self.stamps_s)

    def scans(self) -> Iterator[PointScan]:
        """Yield every scan in order, the empty ones too; RelmapError if a file is damaged."""
        for index, stamp_s in enumerate(self.stamps_s.tolist()):
            pose = None if self.poses is None else self.poses[index]
            motion = None if self.odometry is None else self.odometry[index]
            number, points = self.first_iteration + index, self.points_of(index)
            yield PointScan(number, points, stamp_s, pose, motion)

    def between(self, begin: int, end: int) -> ScanLog:
        """Return the part in iterations ``range(begin, end)``; RelmapError if it is empty."""
        last = self.first_iteration + len(self)
        first, stop = common_range(begin, end, self.first_iteration, last)
        skip, points_of = first - self.first_iteration, self.points_of
        rows = slice(skip, stop - self.first_iteration)
        return replace(
            self,
            points_of=lambda index: points_of(skip + index),
            first_iteration=first,
            **some_of(self, ("stamps_s", "poses", "odometry", "numbers"), rows),
        )


def poses_of(rotation: Rotation, t: Floats) -> Floats:
    """Return poses (k, 4, 4) of k rotations and translations (k, 3)."""
    return transforms(rotation.as_matrix(), t)


def require_rotations(file: Path, poses: Floats) -> None:
    """Raise RelmapError if a pose (k, 4, 4) of a file is not a rotation and a translation."""
    R = poses[:, :3, :3]
    off = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    wrong = np.flatnonzero(~(off <= _ROUNDING) | (np.linalg.det(R) < 0))
    if len(wrong):
        raise invalid(
            file, f"pose {wrong[0]} has no rotation, expected orthogonal rows of length 1"
        )


def planar_poses(x: Floats, y: Floats, yaw: Floats) -> Floats:
    """Return poses (k, 4, 4) in the plane z = 0."""
    return transforms(rotations(yaw[:, None]), np.column_stack([x, y]))


def in_time_order(path: Path, stamps_s: Floats) -> tuple[Ints, Floats]:
    """Return the order of scans in time, and their stamps (seconds) in this order.

    The stamps (k,) are finite and in the order of the log, which is named in warnings. If the clock
    is too coarse to distinguish scans, they are numbered instead. RelmapError if one is too large.
    """
    far = np.flatnonzero(np.abs(stamps_s) > MAX_S)
    if len(far):
        found = f"scan {far[0]} has the time {stamps_s[far[0]]:.10g}"
        raise invalid(path, f"{found}, expected seconds, at most {MAX_S:g}")
    late = int((stamps_s < np.maximum.accumulate(stamps_s)).sum())
    if late:
        warn(path, f"{late} scans out of order: all are sorted by time")
    order = np.argsort(stamps_s, kind="stable")
    ascending = stamps_s[order]
    if (np.diff(ascending) > 0).all():
        return order, ascending
    warn(path, "times repeat: the scans are numbered instead")
    return order, np.arange(len(stamps_s), dtype=np.float64)


def sorted_by_time(path: Path, log: ScanLog, stamps_s: Floats) -> ScanLog:
    """Return a log with given times (k,) of its scans, in the order of `in_time_order`."""
    order, ascending = in_time_order(path, stamps_s)
    return replace(
        log,
        stamps_s=ascending,
        points_of=lambda index: log.points_of(int(order[index])),
        poses=None if log.poses is None else log.poses[order],
        numbers=numbers_of(order),
    )


def numbers_of(order: Ints) -> Ints | None:
    """Return the numbers of scans in the source, given their order (k,); None if it is the same."""
    return order if (np.diff(order) < 0).any() else None
