"""Clouds of points at one height: the scans of a 2-D laser, in files of clouds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.laser import usable_points
from relmap.datasets.scans import ScanLog, stored_scans

ENOUGH = 100
"""Minimum number of points in whose order beams are recognised."""
FLAT_M = 1e-6
"""Largest difference of the heights of points in one plane: they may be rounded."""
ONWARD = 0.75
"""Least fraction of the steps between points that turn the same way, if these are beams in their
order; seen from the robot, some turn back."""


def as_laser(path: Path, log: ScanLog) -> ScanLog:
    """Return a log of clouds as one of 2-D scans, if each is of beams in a level plane.

    The beams must be in their order; otherwise the log is returned as it is.
    """
    scans = _beams(log) if log.dimension == 3 else []
    if sum(int(points.any(axis=1).sum()) for points in scans) < ENOUGH:
        return log
    points, offsets, sensor = np.concatenate(scans), np.cumsum([0, *map(len, scans)]), log.sensor
    within_m = sensor.range_m or np.inf
    usable, limit_m = usable_points(path, points, offsets, within_m)
    if np.isfinite(limit_m):
        sensor = replace(sensor, range_m=min(limit_m, within_m))
    counts = np.concatenate([np.zeros(1, np.int64), np.cumsum(usable)])[offsets]
    laser = stored_scans(points[usable], counts, log.stamps_s)
    return replace(log, dimension=2, points_of=laser.points_of, sensor=sensor)


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
