"""Prediction of live tracks in the next scan, by odometry.

A placement supported by many landmarks needs no odometry.  With few landmarks in view, odometry
restricts the possible matches; with none, it predicts the tracks.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.association.placement import Placement
from relmap.core.geometry.motions import derivatives, rotations, transforms
from relmap.core.motion_noise import MotionNoise, misses_most, missing_way, motion_noise, unit_of
from relmap.core.state.growing import GrowingArray

MEMORY = 256
"""Number of comparisons with motions from landmarks that are kept."""
FIRST, EVERY = 16, 128
"""Number of comparisons before the first estimate of the noise, which then doubles for each further
one; and the maximum number between two estimates."""
SIGMAS = 4.0
"""Standard deviations within which a landmark is matched."""
UNLIKELY = 6.0
"""Standard deviations beyond which a placement that may be due to chance is rejected."""
UNKNOWN = np.full((4, 4), np.nan)
"""A motion that is not known."""
ALONE = 0.5
"""Largest ratio of the distance of a match to that of the next candidate."""


class OdometryGuide:
    """Predicts the positions of tracks, and estimates the noise of the prediction."""

    STATE = "noise _odometry _measured _sd_m _since _steps _n_seen"

    def __init__(self) -> None:
        self.noise = MotionNoise()
        self._odometry: GrowingArray[np.float64] = GrowingArray(np.float64, (4, 4))
        self._measured: GrowingArray[np.float64] = GrowingArray(np.float64, (4, 4))
        self._sd_m: GrowingArray[np.float64] = GrowingArray(np.float64, ())
        self._since = UNKNOWN
        self._steps = 0
        self._n_seen = 0

    def note(self, motion: Floats | None) -> None:
        """Add the motion (4, 4) since the previous scan; None if unknown."""
        if motion is None:
            motion = UNKNOWN
        self._since = self._since @ motion if self._steps else motion
        self._steps += 1

    def forget(self) -> None:
        """Start again from the latest scan."""
        self._since, self._steps = UNKNOWN, 0

    @property
    def knows(self) -> bool:
        """Whether odometry covers the motion since the tracks were last predicted."""
        return math.isfinite(self._since[0, 0]) and not self.noise.is_wrong

    def predicted(self, d: int) -> Placement:
        """Return the placement of the tracks' frame in the scan's by odometry."""
        T_now_before = np.linalg.inv(self.noise.corrected(self._since[None])[0])
        return Placement(T_now_before[:d, :d], T_now_before[:d, 3], 0)

    def sigma_at(self, points: Floats) -> Floats:
        """Return the standard deviations (n,) of predicted points (n, d), metres."""
        sigma_m, sigma_rad = self.noise.sigmas(self._since[None])
        away = np.linalg.norm(points, axis=1)
        return np.asarray(np.hypot(sigma_m[0], sigma_rad[0] * away) * np.sqrt(self._steps))

    def contradicts(self, placement: Placement, points: Floats, noise_m: float) -> bool:
        """Return whether a placement of points (n, d) contradicts odometry."""
        off = np.linalg.norm(
            placement.apply(points) - self.predicted(points.shape[1]).apply(points), axis=1
        )
        sigma = np.hypot(self.sigma_at(points), noise_m)
        return bool(np.median(off / sigma) > UNLIKELY)

    def learn(self, placement: Placement, expected: Floats, noise_m: float) -> None:
        """Compare odometry with a placement that many landmarks (n, d) support, in their frame."""
        if self._steps != 1 or not math.isfinite(self._since[0, 0]):
            return
        moved = transforms(placement.R.T, -placement.R.T @ placement.t)
        middle = expected.mean(axis=0)
        lever = float(middle @ middle) / max(float(np.sum((expected - middle) ** 2)), 1e-12)
        sd_m = np.array(noise_m * np.sqrt(1 / len(expected) + lever))
        compared = ((self._odometry, self._since), (self._measured, moved), (self._sd_m, sd_m))
        for kept, value in compared:
            if len(kept) >= MEMORY:
                kept.drop(len(kept) - MEMORY + 1)
            kept.extend(value[None])
        self._n_seen += 1
        n = self._n_seen
        if n % EVERY == 0 or (n >= FIRST and n & (n - 1) == 0):
            both, unit = (self._odometry.values, self._measured.values), unit_of(expected)
            found = motion_noise(*both, unit=unit) or self.noise
            missed = missing_way(*both, self._sd_m.values, unit)
            self.noise = replace(found, misses=misses_most(np.ones_like(missed), missed))

    def placement(
        self, expected: Floats, points: Floats, noise_m: float, most_m: float
    ) -> Placement:
        """Return the placement of the tracks' frame by odometry and the few landmarks in view.

        `expected` (n, d), metres: tracks, in their frame; `points` (m, d), robot frame, metres;
        `noise_m`: standard deviation of a coordinate's difference between two scans; `most_m`:
        largest distance of a match.
        """
        guess = self.predicted(expected.shape[1])
        there = guess.apply(expected)
        reach_m = np.minimum(SIGMAS * np.hypot(self.sigma_at(there), noise_m), most_m)
        if not len(there) or not len(points):
            return guess
        apart_m = np.linalg.norm(there[:, None] - points, axis=2)
        target, distance = apart_m.argmin(axis=1), apart_m.min(axis=1)
        apart_m[np.arange(len(there)), target] = np.inf
        near = np.flatnonzero(distance <= reach_m)
        near = near[np.argsort(distance[near], kind="stable")]
        rows = near[np.unique(target[near], return_index=True)[1]]  # each point once
        rows = np.sort(rows[distance[rows] <= ALONE * apart_m[rows].min(axis=1)])
        return self._fitted(guess, there[rows], points[target[rows]], noise_m)

    def _fitted(self, guess: Placement, here: Floats, there: Floats, noise_m: float) -> Placement:
        """Return a guess corrected by matches, weighted by the noise of both."""
        if not len(here):
            return guess
        d = here.shape[1]
        sigma_m, sigma_rad = self.noise.sigmas(self._since[None])
        J = derivatives(here)
        q = J.shape[2] - d
        least = np.full(q, 1 / sigma_rad[0] ** 2), np.full(d, 1 / sigma_m[0] ** 2)
        matrix = np.einsum("nda,ndb->ab", J, J) / noise_m**2
        matrix += np.diag(np.concatenate(least) / max(self._steps, 1))
        right = np.einsum("nda,nd->a", J, there - here) / noise_m**2
        try:
            step = np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:  # points so far away exhaust double precision
            return guess
        R = rotations(step[None, :q])[0]
        return Placement(R @ guess.R, R @ guess.t + step[q:], len(here))
