"""Prediction of a scan by odometry, with its uncertainty.

Odometry is compared with the motions that walls determine in all directions. This gives its noise
and systematic errors (`relmap.core.motion_noise`), and whether it is accepted at all.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.motion_noise import (
    WRONG_SCALE,
    WRONG_WAY,
    MotionNoise,
    leaps,
    misses_most,
    missing_turn,
    missing_way,
    motion_noise,
)
from relmap.core.odometry import Motions, OdometryUse
from relmap.planes.motions import from_matrices, inverse, matrices, wrapped
from relmap.planes.odometry.steps import constant_errors, corrected, path_of, stretches

COMPARED, LONG_AGO = 200, 5000
"""Number of last motions that odometry is compared with, and their largest age in scans."""
EVERY, AT_FIRST = 32, 8
"""Interval, in scans, between comparisons; and while there are few."""
ROUGH_M, ROUGH_RAD = 0.03, np.deg2rad(1.0)
"""Errors of motions from walls, which limit the precision of the comparison."""
FAULT = 6.0
"""Log odds of a motion far from the prediction: wheels may slip."""
AGREED = 3.0
"""Log odds gained by a motion that agrees with odometry, which few do by chance."""
FAULTS, FAULTY = 2, 0.05
"""If odometry contradicts the walls more often than this, and in a larger fraction of the steps, it
is rejected: bridges would be wrong as often."""
STRETCH_M = 1.0
"""Length of the stretches of which odometry must not miss most."""
UNKNOWN_M = 3.5
"""Longest step by odometry that was not compared yet: it may be in other units."""
GUESSED = MotionNoise()
"""The noise of odometry that was not compared yet."""
NEVER = -1, -1, -1
OTHERWISE = 4.0
"""Standard deviations above which a motion contradicts odometry."""


class Expected(NamedTuple):
    """Motion expected from odometry.

    `motion` (3,): from the previous frame to that of the scan: yaw, x, y; `sd_m`, `sd_rad`:
    standard deviations, including those of the motions from walls that it is compared with.
    """

    motion: Floats
    sd_m: float
    sd_rad: float

    def off(self, motions: Floats) -> Floats:
        """Return the deviation of motions (k, 3) in standard deviations."""
        way = np.hypot(*(motions[:, 1:] - self.motion[1:]).T) / self.sd_m
        turn = wrapped(motions[:, 0] - self.motion[0]) / self.sd_rad
        return np.asarray(np.hypot(way, turn))

    def supports(self, motions: Floats) -> Floats:
        """Return the log odds of motions (k, 3) given odometry."""
        return np.asarray(AGREED - np.minimum(self.off(motions) ** 2 / 2, FAULT))


class Wheels:
    """The odometry of a run, compared with the motions from scan to scan.

    `given`: the given odometry.
    """

    def __init__(self) -> None:
        self.given = Motions()
        self._noise: MotionNoise | None = None
        self._noise_of = -1
        self._last: tuple[tuple[int, int, int], Expected | None] = NEVER, None

    def expected(
        self, earlier: int, later: int, motions: Floats, measured: Bools
    ) -> Expected | None:
        """Return the motion from an earlier scan to a later one, as expected from odometry.

        `motions` (i, 3): motions from scan to scan; `measured` (i,): which of these are determined
        by walls in all directions. Returns None if odometry is unknown or rejected.
        """
        if not len(self.given):
            return None
        key = earlier, later, len(self.given)
        if self._last[0] != key:
            self._last = key, self._expected(earlier, later, motions, measured)
        return self._last[1]

    def _expected(
        self, earlier: int, later: int, motions: Floats, measured: Bools
    ) -> Expected | None:
        steps = self.given.between(earlier + 1, later + 1)
        noise = self.noise(motions, measured)
        begin = max(earlier + 1 - COMPARED, 0)
        last = self.given.between(begin, later + 1)
        leaping = leaps(last, np.isfinite(last[:, 0, 0]))[earlier + 1 - begin :]  # unlike the last
        if noise is None or not np.isfinite(steps[:, 0, 0]).all() or leaping.any():
            return None
        path = path_of(corrected(noise, steps))
        sd_m, sd_rad = noise.sigmas(steps)
        ahead = np.hypot(*(path[-1] - path)[:, 1:].T)
        off_m = np.sqrt((sd_m**2 + (sd_rad * ahead) ** 2).sum() + ROUGH_M**2)
        off_rad = np.sqrt((sd_rad**2).sum() + ROUGH_RAD**2)
        motion = inverse(path[-1])
        if noise is GUESSED and np.hypot(*motion[1:]) > UNKNOWN_M:
            return None
        return Expected(motion, float(off_m), float(off_rad))

    def noise(self, motions: Floats, measured: Bools) -> MotionNoise | None:
        """Return the recent quality of odometry; None if it is rejected."""
        every = EVERY if len(motions) > EVERY else AT_FIRST
        now = len(motions) // every * every
        if now != self._noise_of:
            begin = max(now - LONG_AGO, 0)
            last = begin + np.flatnonzero(measured[begin:now])[-COMPARED:]
            found, is_accepted = self._compared(last, motions)
            self._noise_of, self._noise = now, found if is_accepted else None
        return self._noise

    def noise_over_all(self, motions: Floats, measured: Bools) -> MotionNoise | None:
        """Return the quality of odometry over a whole run; None if missing or rejected."""
        if not len(self.given):
            return None
        found, is_accepted = self._compared(np.flatnonzero(measured), motions)
        return found if is_accepted else None

    def use(
        self, motions: Floats, measured: Bools, left_out: Bools, hanging: Bools
    ) -> OdometryUse | None:
        """Return how odometry was used; None if there is none."""
        if not len(self.given):
            return None
        found, is_accepted = self._compared(np.flatnonzero(measured), motions)
        use = OdometryUse.of(found, left_out)
        hanging_at = np.flatnonzero(hanging)
        is_used = len(hanging_at) > 0
        return replace(use, is_wrong=not is_accepted, is_used=is_used, hanging=hanging_at)

    def _compared(self, scans: Ints, motions: Floats) -> tuple[MotionNoise, bool]:
        """Return the quality of odometry in some scans (k,), and whether it is accepted."""
        begin, end = int(scans.min(initial=len(motions))), int(scans.max(initial=-1)) + 1
        steps = self.given.between(begin, max(begin, end))[scans - begin]
        there = np.isfinite(steps[:, 0, 0])
        steps, true = steps[there], motions[scans[there]]
        poses = _poses(true)
        found = motion_noise(steps, poses, constant_errors(steps, poses))
        if found is None:
            return GUESSED, True
        off_m = found.sigma_way * float(np.median(np.linalg.norm(steps[:, :2, 3], axis=1)))
        is_noise = found.sigma_way > WRONG_WAY and off_m > ROUGH_M
        faults = int(_otherwise(found, steps, true).sum())
        fails = faults > FAULTS and faults > FAULTY * len(steps)
        fails |= (
            is_noise or abs(found.scale - 1) > WRONG_SCALE or _misses(found.corrected(steps), poses)
        )
        return found, not fails

    def left_out(self, motions: Floats, measured: Bools) -> Bools:
        """Return in which iterations (i,) odometry is rejected.

        Those that contradict the motion measured by walls; all if there are too many.
        """
        steps = self.given.over(len(motions))
        known = np.isfinite(steps[:, 0, 0])
        noise = self.noise_over_all(motions, measured)
        if noise is None:
            return known
        wrong = measured & _otherwise(noise, steps, motions)
        return known & (wrong | (leaps(steps, known) & ~measured))

    def look_again(self) -> None:
        """Forget the noise estimate: motions have changed."""
        self._noise_of, self._last = -1, (NEVER, None)


def _misses(steps: Floats, true: Floats) -> bool:
    """Return whether steps (k, 4, 4) miss most of the way, or of the turns, of motions (k, 4, 4).

    Over stretches, as that of a single step is no more than the error of walls.
    """
    over, seen = stretches(steps, true, np.linalg.norm(true[:, :2, 3], axis=1), STRETCH_M)
    every = np.ones(len(over), dtype=np.bool_)
    if misses_most(every, missing_way(over, seen, np.full(len(over), ROUGH_M))):
        return True
    return misses_most(*missing_turn(over, seen, np.full(len(over), ROUGH_RAD)))


def _otherwise(noise: MotionNoise, steps: Floats, motions: Floats) -> Bools:
    """Return which steps (k, 4, 4) contradict the measured motions (k, 3)."""
    off = corrected(noise, steps) - from_matrices(_poses(motions))
    sd_m, sd_rad = noise.sigmas(steps)
    way = np.hypot(off[:, 1], off[:, 2]) / np.hypot(sd_m, ROUGH_M)
    turn = wrapped(off[:, 0]) / np.hypot(sd_rad, ROUGH_RAD)
    return np.asarray(np.hypot(way, turn) > OTHERWISE)


def _poses(motions: Floats) -> Floats:
    """Return motions (k, 3) as poses (k, 4, 4) of the robot in the previous frame."""
    return np.asarray(np.linalg.inv(matrices(motions)))
