"""Scans that repeat the one before exactly, as of a sensor that is stuck."""

from __future__ import annotations

import logging
from itertools import pairwise

import numpy as np

from relmap.core.arrays import Bools
from relmap.core.motion_noise import MotionNoise, unit_of
from relmap.datasets.base import ObservationLog
from relmap.datasets.scans import ScanLog

logger = logging.getLogger(__name__)

NOISY = 3
"""Minimum number of points of a scan that noise never lets another one repeat exactly: none of 17
real logs of lasers and landmarks has such a scan."""


def copies(log: ObservationLog | ScanLog) -> Bools:
    """Return which scans (k,) repeat the one before exactly."""
    scans = (scan.points_robot for scan in log.scans())
    again = [len(now) >= NOISY and np.array_equal(was, now) for was, now in pairwise(scans)]
    return np.array([False, *again])


def without_copies(log: ObservationLog) -> ObservationLog:
    """Return a log without the points of scans that repeat the one before though odometry moves.

    In these the robot would stand. Odometry moves if it is farther from rest than by its noise.
    """
    if log.odometry is None:
        return log
    noise = MotionNoise(sigma_m=MotionNoise.sigma_m * unit_of(log.points_robot))
    moves = noise.slipped(log.odometry, np.tile(np.eye(4), (len(log), 1, 1)))
    again = copies(log) & moves
    if not again.any():
        return log
    logger.warning(
        "%d of %d scans repeat the one before, though odometry moves: left out",
        again.sum(),
        len(log),
    )
    return log.only(~again[log.iteration - log.first_iteration])
