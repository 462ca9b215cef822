"""Clouds with z = 0 throughout: the scans of a 2-D laser, in files of clouds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.laser import usable_points
from relmap.datasets.scans import ScanLog, SensorView, stored_scans

FIRST = 5
"""Number of scans by which it is decided whether to read all."""
ONWARD = 0.9
"""Least fraction of the steps between points that turn the same way, if these are beams in their
order."""


def as_laser(path: Path, log: ScanLog) -> ScanLog:
    """Return a log of clouds as one of 2-D scans, if all points are beams in the plane z = 0.

    They must be in their order; otherwise the log is returned as it is.
    """
    is_laser = log.dimension == 3 and _are_beams(log, range(min(FIRST, len(log))))
    if not is_laser or not _are_beams(log, range(len(log))):
        return log
    scans = [log.points_of(index)[:, :2] for index in range(len(log))]
    points, offsets = np.concatenate(scans), np.cumsum([0, *map(len, scans)])
    usable, limit_m = usable_points(path, points, offsets)
    counts = np.concatenate([np.zeros(1, np.int64), np.cumsum(usable)])[offsets]
    laser = stored_scans(points[usable], counts, log.stamps_s)
    sensor = SensorView(range_m=limit_m if np.isfinite(limit_m) else None)
    return replace(log, dimension=2, points_of=laser.points_of, sensor=sensor)


def _are_beams(log: ScanLog, scans: range) -> bool:
    """Return whether all points of some scans are at z = 0, and all scans in the order of beams."""
    n_points = 0
    for index in scans:
        points = _read(log, index)
        if points is None or points[:, 2].any() or not _is_ordered(points):
            return False
        n_points += int(points.any(axis=1).sum())
    return n_points > 0


def _read(log: ScanLog, index: int) -> Floats | None:
    """Return the points (n, 3) of a scan; None if its file is damaged."""
    try:
        return log.points_of(index)
    except RelmapError:
        return None


def _is_ordered(points: Floats) -> bool:
    there = points[points.any(axis=1)]  # others have no return
    turn = np.diff(np.unwrap(np.arctan2(there[:, 1], there[:, 0])))
    return len(turn) == 0 or max((turn > 0).mean(), (turn < 0).mean()) >= ONWARD
