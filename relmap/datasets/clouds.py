"""Clouds of points as they are mapped: those at one height as the scans of a 2-D laser.

Of others, points at the largest range of a 3-D lidar are left out where rays without a return are
given there: they would be a surface that moves with the sensor. `laser` treats those of 2-D lasers.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.core.arrays import Bools, Floats, evenly
from relmap.core.errors import RelmapError
from relmap.datasets.laser import SAME, WIDE_SCANS, points_of_laser, require_near
from relmap.datasets.scans import ScanLog
from relmap.datasets.textfile import warn

ENOUGH = 100
"""Minimum number of points in whose order beams are recognised."""
FLAT_M = 1e-6
"""Largest difference of the heights of points in one plane: they may be rounded."""
ONWARD = 0.75
"""Least fraction of the steps between points that turn the same way, if these are beams in their
order; seen from the robot, some turn back."""
SCANS = 20
"""Number of scans, spread over the log, that are searched for such points."""
SHARE, LEAST = 0.01, 30
"""Minimum fraction of the points of a scan, and their number, at the largest range: of a surface
only a point or a thin ring is there."""
SPREAD = 0.02
"""Minimum standard deviation of their directions, unit vectors, across a plane: those of a ring, as
the outermost of a lidar on flat ground, lie in one."""
NEARLY = 0.98
"""The range is at least this fraction of the largest: noise puts a few returns beyond it."""


def as_laser(path: Path, log: ScanLog) -> ScanLog:
    """Return a log of clouds as one of 2-D scans, if each is of beams in a level plane.

    The beams must be in their order; otherwise the log is returned as it is.
    """
    scans = _beams(log) if log.dimension == 3 else []
    if sum(int(points.any(axis=1).sum()) for points in scans) < ENOUGH:
        return log
    laser = points_of_laser(path, scans, log.stamps_s, log.sensor)
    return replace(log, dimension=2, points_of=laser.points_of, sensor=laser.sensor)


def _beams(log: ScanLog) -> list[Floats]:
    """Return the points (n, 2) of all scans; none unless each is at one height, and in order."""
    scans: list[Floats] = []
    for index in range(len(log)):
        try:
            points = log.points_of(index)
        except RelmapError:  # a damaged file, which is reported in its turn
            return []
        there = points[points.any(axis=1)]  # others have no return
        if len(there) and (np.ptp(there[:, 2]) > FLAT_M or not _is_ordered(there)):
            return []
        scans.append(points[:, :2])
    return scans


def _is_ordered(points: Floats) -> bool:
    turn = np.diff(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))
    return len(turn) == 0 or max((turn > 0).mean(), (turn < 0).mean()) >= ONWARD


def without_no_return(path: Path, log: ScanLog) -> ScanLog:
    """Return a log of clouds without points at the range that rays without a return share.

    RelmapError if all points are too far for any sensor.
    """
    some = evenly(len(log), SCANS)
    scans = [points for index in some.tolist() if len(points := _read(log, index))]
    if not scans:
        return log
    ranges_m = [np.linalg.norm(points, axis=1) for points in scans]
    require_near(path, ranges_m)
    same_m = _shared(np.concatenate(ranges_m))
    least_m, most_m = same_m[0], same_m[-1]
    there = [(r >= least_m) & (r <= most_m) for r in ranges_m]
    if most_m == 0 or sum(map(_did_not_return, scans, there)) < WIDE_SCANS:
        return log
    share = f"{100 * np.mean([np.mean(one) for one in there]):.3g} % of the points are"
    at = f"at the largest range, {np.median(same_m):.4g} m, and are treated as no return"
    warn(path, f"{share} {at}")

    def points_of(index: int) -> Floats:
        points = log.points_of(index)
        return np.asarray(points[np.linalg.norm(points, axis=1) < least_m])

    return replace(log, points_of=points_of)


def _shared(ranges_m: Floats) -> Floats:
    """Return those of ranges (n,) that are the same as most others near the largest, ascending."""
    far_m = np.sort(ranges_m[ranges_m >= NEARLY * ranges_m.max()])
    ends = np.searchsorted(far_m, far_m * (1 + SAME), "right")
    most = int(np.argmax(ends - np.arange(len(far_m))))
    return np.asarray(far_m[most : ends[most]])


def _did_not_return(points: Floats, there: Bools) -> bool:
    """Return whether those there of points (n, 3) are many, in directions of more than a ring."""
    if there.sum() < max(LEAST, SHARE * len(points)):
        return False
    way = points[there] / np.linalg.norm(points[there], axis=1, keepdims=True)
    return bool(np.linalg.eigvalsh(np.cov(way.T))[0] >= SPREAD**2)


def _read(log: ScanLog, index: int) -> Floats:
    """Return the points of a scan; none if its file is damaged, which is reported in its turn."""
    try:
        points = log.points_of(index)
    except RelmapError:
        return np.empty((0, 3))
    return np.asarray(points[np.isfinite(points).all(axis=1)])
