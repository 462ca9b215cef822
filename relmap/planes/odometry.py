"""Odometry of a run among walls: where it expects a scan to lie, and how surely.

It is held against the motions that walls fix in all directions: from them come its noise and its
constant errors (`relmap.core.motion_noise`), and whether it is to be believed at all.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relmap.core.motion_noise import WRONG_SCALE, WRONG_WAY, MotionNoise, motion_noise
from relmap.core.odometry import Motions, OdometryUse
from relmap.planes.motions import from_matrices, inverse, matrices
from relmap.planes.steps import corrected, path_of
from relmap.planes.tracks import wrapped

COMPARED, LONG_AGO = 200, 5000
"""Last motions that odometry is held against, and how many scans ago they are at most."""
EVERY, AT_FIRST = 32, 8
"""After how many more scans it is held against them again; and while there are few."""
ROUGH_M, ROUGH_RAD = 0.03, np.deg2rad(1.0)
"""How far off motions from walls may be: they tell no better how good odometry is."""
FAULT = 6.0
"""How unlikely a motion far from where odometry expects it is, for wheels slip: log odds."""
AGREED = 3.0
"""What a motion gains that agrees with odometry: few do by chance."""
FAULTS, FAULTY = 2, 0.05
"""Odometry that is another than what walls measured more often, and in a larger share of the steps,
is not believed: bridges would be wrong as often."""
NEVER = -1, -1, -1
OTHERWISE = 4.0
"""Standard deviations from which a motion is another than odometry tells."""


class Expected(NamedTuple):
    """Where odometry expects the robot.

    Attributes
    ----------
    motion : (3,) float64
        From the frame before into that of the scan: yaw, x, y.
    sd_m, sd_rad : float
        How sure it is, and the motions from walls that it is compared with.
    """

    motion: NDArray[np.float64]
    sd_m: float
    sd_rad: float

    def off(self, motions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how many standard deviations motions (k, 3) are others."""
        way = np.hypot(*(motions[:, 1:] - self.motion[1:]).T) / self.sd_m
        turn = wrapped(motions[:, 0] - self.motion[0]) / self.sd_rad
        return np.asarray(np.hypot(way, turn))

    def supports(self, motions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what odometry tells for motions (k, 3): log odds."""
        return np.asarray(AGREED - np.minimum(self.off(motions) ** 2 / 2, FAULT))


class Wheels:
    """The odometry of a run, held against the motions from scan to scan.

    Attributes
    ----------
    given : Motions
        As it came.
    """

    def __init__(self) -> None:
        self.given = Motions()
        self._noise: MotionNoise | None = None
        self._noise_of = -1
        self._last: tuple[tuple[int, int, int], Expected | None] = NEVER, None

    def expected(
        self,
        earlier: int,
        later: int,
        motions: NDArray[np.float64],
        measured: NDArray[np.bool_],
    ) -> Expected | None:
        """Return how a scan lies to an earlier one.

        Parameters
        ----------
        earlier, later : int
        motions : (i, 3) float64
            From scan to scan.
        measured : (i,) bool
            Which of these walls fix in all directions.

        Returns
        -------
        Expected or None
            None where odometry is not known, or not believed.
        """
        if not len(self.given):
            return None
        key = earlier, later, len(self.given)
        if self._last[0] != key:
            self._last = key, self._expected(earlier, later, motions, measured)
        return self._last[1]

    def _expected(
        self,
        earlier: int,
        later: int,
        motions: NDArray[np.float64],
        measured: NDArray[np.bool_],
    ) -> Expected | None:
        steps = self.given.between(earlier + 1, later + 1)
        noise = self.noise(motions, measured)
        if noise is None or not np.isfinite(steps[:, 0, 0]).all():
            return None
        path = path_of(corrected(noise, steps))
        sd_m, sd_rad = noise.sigmas(steps)
        ahead = np.hypot(*(path[-1] - path)[:, 1:].T)
        off_m = np.sqrt((sd_m**2 + (sd_rad * ahead) ** 2).sum() + ROUGH_M**2)
        off_rad = np.sqrt((sd_rad**2).sum() + ROUGH_RAD**2)
        motion = inverse(path[-1])
        return Expected(motion, float(off_m), float(off_rad))

    def noise(
        self, motions: NDArray[np.float64], measured: NDArray[np.bool_]
    ) -> MotionNoise | None:
        """Return how good odometry was lately; None where it is not believed."""
        every = EVERY if len(motions) > EVERY else AT_FIRST
        now = len(motions) // every * every
        if now != self._noise_of:
            begin = max(now - LONG_AGO, 0)
            last = begin + np.flatnonzero(measured[begin:now])[-COMPARED:]
            found, is_believed = self._compared(last, motions)
            self._noise_of, self._noise = now, found if is_believed else None
        return self._noise

    def noise_over_all(
        self, motions: NDArray[np.float64], measured: NDArray[np.bool_]
    ) -> MotionNoise | None:
        """Return how good odometry was in a whole run; None where it is not believed, or none."""
        if not len(self.given):
            return None
        found, is_believed = self._compared(np.flatnonzero(measured), motions)
        return found if is_believed else None

    def use(
        self,
        motions: NDArray[np.float64],
        measured: NDArray[np.bool_],
        left_out: NDArray[np.bool_],
        hanging: NDArray[np.bool_],
    ) -> OdometryUse | None:
        """Return what was made of odometry; None where there is none."""
        if not len(self.given):
            return None
        found, _ = self._compared(np.flatnonzero(measured), motions)
        use = OdometryUse.of(found, left_out)
        return replace(use, is_used=bool(hanging.any()), hanging=np.flatnonzero(hanging))

    def _compared(
        self, scans: NDArray[np.int64], motions: NDArray[np.float64]
    ) -> tuple[MotionNoise, bool]:
        """Return how good odometry is in some scans (k,), and whether it is believed."""
        begin, end = int(scans.min(initial=len(motions))), int(scans.max(initial=-1)) + 1
        steps = self.given.between(begin, max(begin, end))[scans - begin]
        there = np.isfinite(steps[:, 0, 0])
        steps, true = steps[there], motions[scans[there]]
        found = motion_noise(steps, _poses(true))
        if found is None:
            return MotionNoise(), True
        off_m = found.sigma_way * float(np.median(np.linalg.norm(steps[:, :2, 3], axis=1)))
        is_noise = found.sigma_way > WRONG_WAY and off_m > ROUGH_M
        faults = int(_otherwise(found, steps, true).sum())
        fails = faults > FAULTS and faults > FAULTY * len(steps)
        return found, not (is_noise or fails or abs(found.scale - 1) > WRONG_SCALE)

    def left_out(
        self, motions: NDArray[np.float64], measured: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Tell in which iterations (i,) odometry is not believed.

        It is another than what walls measured; all where that is so too often.
        """
        steps = self.given.over(len(motions))
        known = np.isfinite(steps[:, 0, 0])
        noise = self.noise_over_all(motions, measured)
        return known & measured & _otherwise(noise, steps, motions) if noise else known

    def look_again(self) -> None:
        """Forget what was found of its noise: motions have changed."""
        self._noise_of, self._last = -1, (NEVER, None)


def _otherwise(
    noise: MotionNoise, steps: NDArray[np.float64], motions: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Tell which steps (k, 4, 4) are others than motions (k, 3) measured."""
    off, (sd_m, sd_rad) = (
        corrected(noise, steps) - from_matrices(_poses(motions)),
        noise.sigmas(steps),
    )
    way = np.hypot(off[:, 1], off[:, 2]) / np.hypot(sd_m, ROUGH_M)
    turn = wrapped(off[:, 0]) / np.hypot(sd_rad, ROUGH_RAD)
    return np.asarray(np.hypot(way, turn) > OTHERWISE)


def _poses(motions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return motions (k, 3) as the poses (k, 4, 4) of the robot after them in the frame before."""
    return np.asarray(np.linalg.inv(matrices(motions)))
