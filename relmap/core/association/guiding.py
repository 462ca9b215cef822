"""Where live tracks lie in the next scan, by odometry.

A placement that many landmarks agree on needs no odometry.  Where few are in view it narrows what
they may be, and where none are it carries the tracks along.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.association.placement import Placement
from relmap.core.motion_noise import MotionNoise, motion_noise
from relmap.core.state.growing import GrowingArray

MEMORY = 256
"""Comparisons with what landmarks tell that are remembered."""
FIRST, EVERY = 16, 128
"""Comparisons after which odometry is judged for the first time, then twice as many, and so on; and
most that are waited for."""
SIGMAS = 4.0
"""Standard deviations within which a landmark is looked for."""
UNLIKELY = 6.0
"""Standard deviations beyond which a placement that chance may have made is not believed."""
ALONE = 0.5
"""A match counts where no other is within twice as far."""


class OdometryGuide:
    """Predicts where tracks are seen next, and learns how well.

    Attributes
    ----------
    noise : MotionNoise
    """

    STATE = "noise _odometry _measured _since _steps _n_seen"

    def __init__(self) -> None:
        self.noise = MotionNoise()
        self._odometry: GrowingArray[np.float64] = GrowingArray(np.float64, (4, 4))
        self._measured: GrowingArray[np.float64] = GrowingArray(np.float64, (4, 4))
        self._since = np.full((4, 4), np.nan)
        self._steps = 0
        self._n_seen = 0

    def note(self, motion: Floats | None) -> None:
        """Take in the motion (4, 4) since the scan before; None where it is not known."""
        if motion is None:
            motion = np.full((4, 4), np.nan)
        self._since = self._since @ motion if self._steps else motion
        self._steps += 1

    def forget(self) -> None:
        """Begin anew from the scan that was just taken in."""
        self._since, self._steps = np.full((4, 4), np.nan), 0

    @property
    def knows(self) -> bool:
        """Whether odometry covers the motion since the tracks were last carried along."""
        return bool(np.isfinite(self._since[0, 0])) and not self.noise.is_wrong

    def predicted(self, d: int) -> Placement:
        """Return the placement of the tracks' frame in the scan's by odometry."""
        T_now_before = np.linalg.inv(self.noise.corrected(self._since[None])[0])
        return Placement(T_now_before[:d, :d], T_now_before[:d, 3], 0)

    def sigma_at(self, points: Floats) -> Floats:
        """Return how far off points (n, d) may be where they are predicted, metres, typically."""
        sigma_m, sigma_rad = self.noise.sigmas(self._since[None])
        away = np.linalg.norm(points, axis=1)
        return np.asarray(np.hypot(sigma_m[0], sigma_rad[0] * away) * np.sqrt(self._steps))

    def contradicts(self, placement: Placement, points: Floats, noise_m: float) -> bool:
        """Tell whether a placement brings points (n, d) where the robot hardly can have gone."""
        off = np.linalg.norm(
            placement.apply(points) - self.predicted(points.shape[1]).apply(points), axis=1
        )
        sigma = np.hypot(self.sigma_at(points), noise_m)
        return bool(np.median(off / sigma) > UNLIKELY)

    def learn(self, placement: Placement) -> None:
        """Compare odometry with a placement that many landmarks support."""
        if self._steps != 1 or not np.isfinite(self._since[0, 0]):
            return
        d = len(placement.t)
        moved = np.eye(4)
        moved[:d, :d], moved[:d, 3] = placement.R.T, -placement.R.T @ placement.t
        for kept, motion in ((self._odometry, self._since), (self._measured, moved)):
            if len(kept) >= MEMORY:
                kept.drop(len(kept) - MEMORY + 1)
            kept.extend(motion[None])
        self._n_seen += 1
        n = self._n_seen
        if n % EVERY == 0 or (n >= FIRST and n & (n - 1) == 0):
            found = motion_noise(self._odometry.values, self._measured.values)
            self.noise = found or self.noise

    def placement(
        self, expected: Floats, points: Floats, noise_m: float, most_m: float
    ) -> Placement:
        """Return the placement of the tracks' frame by odometry and the few landmarks in view.

        Parameters
        ----------
        expected : (n, d) float64, metres
            Tracks, in their frame.
        points : (m, d) float64, robot frame, metres
        noise_m : float
            Of a coordinate's difference between two scans.
        most_m : float
            Farthest that a match may be.
        """
        from relmap.core.association.matching_kernels import claims, nearest_within

        guess = self.predicted(points.shape[1])
        there = guess.apply(expected)
        reach = np.minimum(SIGMAS * np.hypot(self.sigma_at(there), noise_m), most_m)
        if not len(there) or not len(points):
            return guess
        distance, target = nearest_within(points, there, float(reach.max()) / ALONE)
        apart = np.where(distance <= reach, distance, np.inf)
        matched = claims(target, apart, len(points)) & self._clear(there, points, distance)
        rows = np.flatnonzero(matched)
        return self._fitted(guess, there[rows], points[target[rows]], noise_m)

    def _clear(self, there: Floats, points: Floats, distance: Floats) -> Bools:
        """Tell for which tracks no other point is nearly as near as the nearest."""
        apart = np.linalg.norm(there[:, None] - points[None], axis=2)
        if apart.shape[1] < 2:
            return np.ones(len(there), dtype=bool)
        return np.asarray(distance <= ALONE * np.partition(apart, 1, axis=1)[:, 1])

    def _fitted(self, guess: Placement, here: Floats, there: Floats, noise_m: float) -> Placement:
        """Return a guess corrected by matches, each as far as it can be believed."""
        if not len(here):
            return guess
        from relmap.core.geometry.motions import derivatives, rotations

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
