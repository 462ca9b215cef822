"""Odometry as a map of a whole run takes it: without constant errors, with its own noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.motion_noise import STILL_M, MotionNoise, motion_noise
from relmap.planes.motion_factors import MotionFactors
from relmap.planes.motions import from_matrices, matrices

BESIDE = 8
"""Scans beside those that hang on odometry that it holds, too: walls come into view bit by bit."""
WAY_M = 3.0
"""Length over which the noise of odometry itself is measured."""


@dataclass(frozen=True, eq=False)
class Steps:
    """What odometry adds to a map of a whole run, where walls do not tell the motion.

    Attributes
    ----------
    motion : (i, 3) float64
        Pose of each iteration in the frame of the one before, without constant errors: yaw, x, y;
        NaN where it is not known.
    variance : (i, 2) float64
        Of the yaw, square radians, and of x and y, square metres.
    needed : (i,) bool
        Which motions hang on it.
    """

    motion: NDArray[np.float64]
    variance: NDArray[np.float64]
    needed: NDArray[np.bool_]

    def between(self, iterations: NDArray[np.int64]) -> MotionFactors:
        """Return the factors between these iterations (k,), each and the next, that are needed."""
        needed = np.append(0, np.cumsum(self.needed))[iterations + 1]
        pairs = np.flatnonzero(np.diff(needed) > 0)
        both, motion, sd = [], [], []
        for k in pairs.tolist():
            rows = slice(iterations[k] + 1, iterations[k + 1] + 1)
            if np.isfinite(self.motion[rows]).all():
                both.append((k, k + 1))
                motion.append(composed(self.motion[rows]))
                sd.append(np.sqrt(self.variance[rows].sum(axis=0)))
        if not both:
            return MotionFactors()
        return MotionFactors(np.array(both), np.array(motion), np.array(sd))


def steps_of(
    noise: MotionNoise,
    given: NDArray[np.float64],
    n_measured: int,
    submaps: Sequence[tuple[slice, NDArray[np.float64]]],
    hanging: NDArray[np.bool_],
) -> Steps:
    """Return what odometry adds to a map of a whole run.

    How good it is show ways of `WAY_M` and more over which walls tell where the robot went: from
    scan to scan these tell no better.

    Parameters
    ----------
    noise : MotionNoise
        Of odometry, and the motions from scan to scan, together.
    given : (i, 4, 4) float64
        Odometry; NaN where it is not believed.
    n_measured : int
        Of how many steps that was estimated.
    submaps : sequence of (slice, (k, 4, 4) float64)
        The iterations of each and their poses; NaN where one is of another submap.
    hanging : (i,) bool
        Which motions hang on odometry.
    """
    steps, (sd_m, sd_rad) = corrected(noise, given), noise.sigmas(given)
    way, typical_m = np.hypot(steps[:, 1], steps[:, 2]), _typical(steps)
    known = np.isfinite(way)
    variance = np.column_stack([sd_rad**2, sd_m**2])
    over, true = _compared(steps, submaps, known & ~hanging)
    found, n, length = motion_noise(over, true), max(n_measured, 1), typical_m
    sd = np.array([noise.sigma_rad, noise.sigma_way * typical_m])
    if found is not None:
        length = float(np.median(np.hypot(*over[:, :2, 3].T)))
        n = max(round(way[known & ~hanging].sum() / length), 1)
        sd = np.array([found.sigma_rad, found.sigma_way * length])
        variance = np.maximum(way, STILL_M)[:, None] / length * sd**2
        steps = _again(found, steps)
    # The constant errors are as unsure on each metre, and that adds up.
    variance += (way * _together(way, hanging))[:, None] * (sd / length) ** 2 / n
    beside = np.convolve(hanging, np.ones(2 * BESIDE + 1))[BESIDE : BESIDE + len(hanging)] > 0
    return Steps(steps, variance, beside & known)


def _compared(
    steps: NDArray[np.float64],
    submaps: Sequence[tuple[slice, NDArray[np.float64]]],
    known: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return motions (k, 4, 4) over ways of `WAY_M` by steps (i, 3) and by poses of submaps."""
    way, path = np.hypot(steps[:, 1], steps[:, 2]), matrices(path_of(np.nan_to_num(steps)))
    pairs = [(np.empty((0, 4, 4)), np.empty((0, 4, 4)))]
    for rows, poses in submaps:
        a, b = _windows(poses, way[rows], known[rows])
        told = path[rows]
        pairs.append(
            (np.linalg.inv(told[a]) @ told[b], np.linalg.inv(poses[a]) @ poses[b]),
        )
    over, true = (np.concatenate(each) for each in zip(*pairs, strict=True))
    return over, true


def corrected(noise: MotionNoise, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return steps (k, 4, 4) in the plane without the constant errors (k, 3): yaw, x, y."""
    return _again(noise, from_matrices(steps))


def _again(noise: MotionNoise, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return steps (k, 3) without constant errors."""
    way = np.hypot(steps[:, 1], steps[:, 2])
    yaw = steps[:, 0] + way * noise.turn_per_m[2]
    return np.column_stack([yaw, noise.scale * steps[:, 1:]])


def _typical(steps: NDArray[np.float64]) -> float:
    """Return the typical way of steps (i, 3), of those that are known; metres."""
    way = np.hypot(steps[:, 1], steps[:, 2])
    known = way[np.isfinite(way)]
    return max(float(np.median(known)), STILL_M) if len(known) else STILL_M


def _together(way: NDArray[np.float64], needed: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the length (i,) of all needed steps in a row with each one, metres.

    What is off in the constant errors adds up over it, unlike noise.
    """
    run = np.cumsum(np.diff(needed, prepend=False))
    return np.asarray(np.bincount(run, np.nan_to_num(way) * needed)[run])


def path_of(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the poses (k, 3) after steps (k, 3), in the frame before the first: yaw, x, y."""
    yaw = np.cumsum(steps[:, 0])
    c, s = np.cos(yaw - steps[:, 0]), np.sin(yaw - steps[:, 0])
    x, y = steps[:, 1:].T
    return np.column_stack([yaw, np.cumsum(c * x - s * y), np.cumsum(s * x + c * y)])


def composed(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return steps (k, 3), one after the other, as one (3,)."""
    return np.asarray(path_of(steps)[-1])


def _windows(
    poses: NDArray[np.float64], way: NDArray[np.float64], known: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first and last iteration of ways of `WAY_M` with poses (i, 4, 4) that are known.

    They overlap.  `way` (i,) is that of each step, and steps are `known` (i,) or not.
    """
    goes_on = known & np.isfinite(poses[:, 0, 0])
    goes_on[1:] &= np.isfinite(poses[:-1, 0, 0])
    gone = np.cumsum(np.nan_to_num(way))
    ends = np.searchsorted(gone, gone + WAY_M)
    broken = np.append(np.cumsum(~goes_on), len(way) + 1)
    whole = broken[ends] == broken[:-1]
    return np.flatnonzero(whole), ends[whole]
