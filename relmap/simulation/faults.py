"""Faults of wheel odometry, applied to a log; one function each.

Each function takes a log and returns a new one. A `RelmapError` is raised if the log has no
odometry.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.odometry import motions, path_of, poses_at, relative
from relmap.datasets.scans import ScanLog

Log = TypeVar("Log", bound=ObservationLog | ScanLog)


def slipping_wheels(log: Log, share: float, rng: np.random.Generator) -> Log:
    """Make the odometry count the translation of a fraction of the steps twice.

    A `RelmapError` is also raised if the share is not in [0, 1].
    """
    if not 0 <= share <= 1:
        raise RelmapError(f"share is {share}; it must lie in [0, 1]")
    odometry = _odometry(log).copy()
    slips = rng.choice(len(odometry), round(share * len(odometry)), replace=False)
    odometry[slips, :3, 3] *= 2
    return replace(log, odometry=odometry)


def reversed_odometry(log: Log) -> Log:
    """Make the odometry report backward motion for forward motion, with mirrored rotation."""
    odometry = _odometry(log)
    return replace(log, odometry=relative(odometry, np.broadcast_to(np.eye(4), odometry.shape)))


def stale_odometry(log: Log, late: float) -> Log:
    """Delay the odometry by a number of seconds, or of iterations if the log has no clock.

    Motions before the start of the log, and next to unknown motions, are unknown.
    """
    odometry = _odometry(log)
    at = np.arange(float(len(log))) if log.stamps_s is None else log.stamps_s
    stale = motions(poses_at(at, path_of(odometry), at - late))
    unknown = np.asarray(np.isnan(odometry).any(axis=(1, 2)))
    unknown[0] = False
    before = np.clip(np.searchsorted(at, at - late), 1, len(at) - 1)
    around = unknown[before] | unknown[np.roll(before, 1)] | unknown[before - 1]
    stale[around] = np.nan
    return replace(log, odometry=stale)


def _odometry(log: ObservationLog | ScanLog) -> Floats:
    if log.odometry is None:
        raise RelmapError("the log has no odometry, and a fault of wheels needs it")
    return log.odometry
