"""Systematic errors and noise of odometry.

Odometry is compared with motions that landmarks determine more accurately.  Wheels slip, and stamps
may be delayed, so the fits are robust: up to half of the steps may be wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Bools, Floats
from relmap.core.scan import TINY

FEWEST = 8
"""Minimum number of comparisons."""
NORMAL = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of a normal distribution."""
ROUNDS = 10
"""Steps of weighted least squares towards least absolute deviations (Schlossmacher, 1973)."""
SLIPPED = 6.0
"""Standard deviations beyond which a step of odometry is wrong."""
WRONG_SCALE, WRONG_WAY, WRONG_RAD = 0.3, 0.5, 0.2
"""Error of the scale, and noise relative to the distance and of a turn, beyond which odometry is
rejected. Turns in degrees are as noisy."""
LEAP, USUALLY, LEAP_M = 10.0, 0.9, 5.0
"""A step so many times longer than this fraction of the steps, and this long, is a fault."""
STILL_M = 1e-3
"""Distance below which the robot stands still."""
MOST_TURNING, AT_MOST = 0.95, 0.05
"""Quantile of the compared turns up to which their noise is known, and maximum noise of a larger
turn, relative to it."""
FLOOR_M, FLOOR_RAD = 1e-4, 1e-5
"""Minimum standard deviations: files are rounded."""
UNITS, USUAL_M = 1024.0, 10.0
"""Ratio of units of length, nearly that of metres to millimetres, and usual range of landmarks: by
these the unit of the data is guessed, as lengths given in metres are compared with them."""


@dataclass(frozen=True, eq=False)
class MotionNoise:
    """Constant errors of odometry, and standard deviations of the rest of a step.

    `scale`: distance travelled by the robot, relative to that of its odometry; `turn_per_m` (3,):
    turn (a rotation vector) that odometry misses per metre, radians; `sigma_way`: standard
    deviation of each coordinate, relative to the distance; `sigma_m`, `sigma_rad`: constant part of
    it, and standard deviation of the angle about each axis, per step, up to a turn of `turn_rad`:
    beyond, it may grow with the turn. `misses`: whether it misses most of the motion in most of the
    steps, as that of a stuck encoder does.
    """

    scale: float = 1.0
    turn_per_m: Floats = field(default_factory=lambda: np.zeros(3))
    sigma_way: float = 0.05
    sigma_m: float = 0.002
    sigma_rad: float = 0.005
    turn_rad: float = np.inf
    misses: bool = False

    @property
    def is_wrong(self) -> bool:
        """Whether it is rejected as a whole: of another robot, or another time."""
        is_noisy = self.sigma_way > WRONG_WAY or self.sigma_rad > WRONG_RAD
        return bool(abs(self.scale - 1) > WRONG_SCALE or is_noisy or self.misses)

    @property
    def is_assumed(self) -> bool:
        """Whether it is the usual noise, as landmarks never determine a motion to compare."""
        return self.turn_rad == np.inf and self.sigma_rad == MotionNoise.sigma_rad

    def corrected(self, odometry: Floats) -> Floats:
        """Return motions (k, 4, 4) without the constant errors."""
        found = odometry.copy()
        found[:, :3, 3] *= self.scale
        way = np.linalg.norm(odometry[:, :3, 3], axis=1)
        turn = _turns(odometry) + way[:, None] * self.turn_per_m
        known = np.isfinite(way)
        found[known, :3, :3] = Rotation.from_rotvec(turn[known]).as_matrix()
        return found

    def sigmas(self, odometry: Floats) -> tuple[Floats, Floats]:
        """Return the standard deviations (k,) of a coordinate, metres, and an angle, radians."""
        way = np.linalg.norm(odometry[:, :3, 3], axis=1)
        sigma_rad = np.full(len(way), self.sigma_rad)
        if self.turn_rad < np.inf:
            turn = np.linalg.norm(_turns(odometry), axis=1)
            grown = np.minimum(self.sigma_rad / max(self.turn_rad, FLOOR_RAD), AT_MOST) * turn
            sigma_rad = np.fmax(sigma_rad, grown)
        return np.hypot(self.sigma_way * way, self.sigma_m), sigma_rad

    def slipped(
        self, odometry: Floats, measured: Floats, sd_m: ArrayLike = 0.0, sd_rad: ArrayLike = 0.0
    ) -> Bools:
        """Return in which steps (k,) odometry contradicts measured motions (k, 4, 4).

        `odometry`, `measured` (k, 4, 4); `sd_m`, `sd_rad` (k,): standard deviations of the measured
        motions: of a coordinate, metres, and of the angle.
        """
        off_m, off_rad = _apart(self.corrected(odometry), measured)
        sigma_m, sigma_rad = self.sigmas(odometry)
        is_far = off_m > SLIPPED * np.hypot(sigma_m, sd_m)
        return np.asarray(is_far | (off_rad > SLIPPED * np.hypot(sigma_rad, sd_rad)))


def unit_of(points: Floats) -> float:
    """Return the unit of length of landmarks (n, d), robot frame: 1 if they are in metres."""
    usual = float(np.median(np.linalg.norm(points, axis=1))) if len(points) else USUAL_M
    return float(UNITS ** round(np.log(max(usual, TINY) / USUAL_M) / np.log(UNITS)))


def motion_noise(
    odometry: Floats, measured: Floats, constant: MotionNoise | None = None, unit: float = 1.0
) -> MotionNoise | None:
    """Return errors and noise of odometry from more accurate motions; None if there are too few.

    Leaps of odometry do not count: as the longest steps they would determine the scale.

    `odometry`, `measured` (k, 4, 4): pose of the robot in its previous frame; NaN if unknown.
    `constant`: the constant errors, if known from longer motions; `unit`: of length (`unit_of`).
    """
    both = np.isfinite(odometry[:, 0, 0]) & np.isfinite(measured[:, 0, 0])
    both &= ~leaps(odometry, both, unit)
    if both.sum() < FEWEST:
        return None
    odometry, measured = odometry[both], measured[both]
    way = np.linalg.norm(odometry[:, :3, 3], axis=1)
    goes = way > STILL_M * unit
    found = constant or _constant(odometry, measured, goes)
    scale, per_m = found.scale, found.turn_per_m
    corrected, axes = found.corrected(odometry), _axes(odometry, measured)
    off = np.abs(corrected[:, :3, 3] - measured[:, :3, 3])[:, :axes]
    rad = _apart(corrected, measured)[1]
    still_m = NORMAL * float(np.median(off[~goes])) if (~goes).sum() >= FEWEST else 0.0
    off_m = NORMAL * np.median(off[goes] / way[goes, None]) if goes.any() else 0.0
    sigma_rad = NORMAL * float(np.median(rad)) / (1.0 if axes == 2 else np.sqrt(3))
    turn_rad = float(np.quantile(np.linalg.norm(_turns(odometry), axis=1), MOST_TURNING))
    noise = max(still_m, FLOOR_M * unit), max(sigma_rad, FLOOR_RAD)
    return MotionNoise(scale, per_m, float(off_m), *noise, turn_rad)


def leaps(odometry: Floats, usual: Bools, unit: float = 1.0) -> Bools:
    """Return which motions (k, 4, 4) are `LEAP` times longer than most, as if encoders were reset.

    `usual` (k,): which motions count as usual; `unit`: of length (`unit_of`).
    """
    way = np.linalg.norm(odometry[:, :3, 3], axis=1)
    goes = way[usual & (way > STILL_M * unit)]
    usual_m = float(np.quantile(goes, USUALLY)) if len(goes) else np.inf
    return np.asarray(way > max(LEAP * usual_m, LEAP_M * unit))


def missing_way(odometry: Floats, measured: Floats, sd_m: Floats, unit: float = 1.0) -> Bools:
    """Return which motions (k,) odometry surely misses: it is off by more than half of the way.

    Both are much more than the errors of landmarks and the usual ones of odometry at rest.

    `odometry`, `measured` (k, 4, 4); `sd_m` (k,): standard deviations of measured coordinates;
    `unit`: of length (`unit_of`).
    """
    off_m, way = _apart(odometry, measured)[0], np.linalg.norm(measured[:, :3, 3], axis=1)
    least_m = SLIPPED * np.hypot(sd_m, MotionNoise.sigma_m * unit)
    return np.asarray((way > least_m) & (off_m > np.maximum(WRONG_WAY * way, least_m)))


def missing_turn(odometry: Floats, measured: Floats, sd_rad: Floats) -> tuple[Bools, Bools]:
    """Return which turns (k,) landmarks measure well, and which of these odometry surely misses.

    It is off by more than half of these, about their axis: about the others it is only noisy.
    """
    turns = _turns(measured)
    off, turn = np.sum(_turned(odometry, measured) * turns, axis=1), np.linalg.norm(turns, axis=1)
    judged = np.isfinite(off) & (turn > SLIPPED * np.hypot(sd_rad, MotionNoise.sigma_rad))
    return judged, judged & (np.abs(off) > WRONG_WAY * turn**2)


def turns_otherwise(odometry: Floats, measured: Floats, sigma_rad: float) -> Bools:
    """Return which turns (k,) odometry makes, too, but surely otherwise: mirrored, or in degrees.

    By more than half of the measured turn, about its axis, and far off for its noise, of a step.
    Landmarks that show a turn by mistake do not make odometry turn.
    """
    turns = _turns(measured)
    own = np.abs(np.sum(_turns(odometry) * turns, axis=1)) > WRONG_WAY * np.sum(turns**2, axis=1)
    return np.asarray(own & (_apart(odometry, measured)[1] > SLIPPED / 2 * sigma_rad))


def misses_most(compared: Bools, missed: Bools) -> bool:
    """Return whether odometry misses most of the compared steps (k,), if these are enough."""
    return bool(compared.sum() >= FEWEST and missed.sum() > compared.sum() / 2)


def _constant(odometry: Floats, measured: Floats, goes: Bools) -> MotionNoise:
    """Return the constant errors of motions (k, 4, 4); in some, the robot moves (k,)."""
    t, way, scale = odometry[:, :3, 3], np.linalg.norm(odometry[:, :3, 3], axis=1), 1.0
    if goes.sum() >= FEWEST:
        lacks = (measured[goes, :3, 3] - t[goes]).ravel()
        scale = 1 + _least_deviations(t[goes].ravel(), lacks)
    lacks = _turns(measured) - _turns(odometry)
    per_m = np.zeros(3)
    for axis in range(3) if _axes(odometry, measured) == 3 else (2,):
        per_m[axis] = _least_deviations(way, lacks[:, axis])
    return MotionNoise(scale, per_m)


def _least_deviations(column: Floats, values: Floats) -> float:
    """Return the factor of a column (n,) with least absolute deviations from values (n,)."""
    weight, found = np.ones(len(values)), 0.0
    least = 1e-6 * max(float(np.abs(values).max(initial=0.0)), 1e-12)
    for _ in range(ROUNDS):
        weighed = weight * column
        square = float(weighed @ column)
        found = float(weighed @ values) / square if square > 0 else 0.0
        off = np.abs(values - column * found)
        # Squares below a typical deviation (Huber, 1964): else the fit stops where one is 0.
        weight = 1 / np.maximum(off, max(NORMAL * float(np.median(off)), least))
    return found


def _turns(motions: Floats) -> Floats:
    """Return the rotation vectors (k, 3) of motions; NaN if unknown."""
    found = np.full((len(motions), 3), np.nan)
    known = np.isfinite(motions[:, 0, 0])
    if known.any():
        found[known] = Rotation.from_matrix(motions[known, :3, :3]).as_rotvec()
    return found


def _apart(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Return the distances, metres, and angles, radians, between motions (k, 4, 4) and others."""
    off_m = np.linalg.norm(first[:, :3, 3] - second[:, :3, 3], axis=1)
    return off_m, np.linalg.norm(_turned(first, second), axis=1)


def _turned(first: Floats, second: Floats) -> Floats:
    """Return the rotation vectors (k, 3) from motions (k, 4, 4) to others; NaN if unknown."""
    return _turns(np.swapaxes(first[:, :3, :3], 1, 2) @ second[:, :3, :3])


def _axes(*motions: Floats) -> int:
    """Return the number of axes of motions: 2 if all are in the plane."""
    return 3 if any((np.abs(motion[:, 2, 3]) > 0).any() for motion in motions) else 2
