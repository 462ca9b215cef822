"""Odometry for the map of a whole run: without systematic errors, with its own noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.motion_noise import STILL_M, MotionNoise, leaps, motion_noise
from relmap.core.refinement.schur import Linearised
from relmap.planes.motions import from_matrices, matrices, wrapped

BESIDE = 8
"""Scans next to those that depend on odometry that it also constrains: walls come into view
gradually."""
WAY_M = 3.0
"""Distance over which the noise of odometry is measured."""
APART = 4
"""Minimum number of such distances in a path that determines constant errors."""


@dataclass(frozen=True, eq=False)
class MotionFactors:
    """Odometry factors between pairs of iterations, where walls do not determine the motion.

    Poses are eliminated one by one, but a factor involves two. So it is split into two factors with
    half the variance each, which connect both poses to an auxiliary pose that is kept. l pairs:
    `both` (l, 2): the earlier and the later one; `motion` (l, 3): pose of the later in the frame of
    the earlier: yaw, x, y; `sd` (l, 2): standard deviations of the yaw, radians, and of x and y,
    metres.
    """

    both: Ints = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    motion: Floats = field(default_factory=lambda: np.empty((0, 3)))
    sd: Floats = field(default_factory=lambda: np.empty((0, 2)))

    def __len__(self) -> int:
        return len(self.both)

    def and_those(self, more: MotionFactors) -> MotionFactors:
        """Return these factors and others."""
        motion = np.concatenate([self.motion, more.motion])
        sd = np.concatenate([self.sd, more.sd])
        return MotionFactors(np.concatenate([self.both, more.both]), motion, sd)

    @property
    def iteration(self) -> Ints:
        """Iteration of each residual, (6 l,): yaw, x, y of the earlier, then the later."""
        return np.repeat(self.both.T, 3)

    @property
    def residual_sd(self) -> Floats:
        """Standard deviation of each residual, (6 l,)."""
        return np.tile(self.sd[:, [0, 1, 1]].ravel() / np.sqrt(2), 2)

    def added_to(self, seen: Linearised, yaw: Floats, t: Floats) -> Linearised:
        """Append residuals and Jacobians of the factors.

        The Jacobians are by the pose and by the auxiliary pose, which is midway between the two.
        `yaw` (i,) and `t` (i, 2) are of all poses.
        """
        earlier, later = self.both.T
        c, s = np.cos(yaw[earlier]), np.sin(yaw[earlier])
        x, y = self.motion[:, 1:].T
        led = np.column_stack([c * x - s * y, s * x + c * y])
        turn = wrapped(yaw[earlier] + self.motion[:, 0] - yaw[later])
        off = np.column_stack([turn, t[earlier] + led - t[later]]).ravel() / 2
        by_later = np.tile(np.eye(3), (len(self), 1, 1))
        by_earlier = by_later.copy()
        by_earlier[:, 1, 0], by_earlier[:, 2, 0] = -led[:, 1], led[:, 0]
        by_pose = np.concatenate([by_earlier, by_later]).reshape(-1, 3)
        by_kept = np.tile([-1.0, 0.0], (len(by_pose), 1))
        return Linearised(
            np.concatenate([seen.off, off, -off]),
            np.concatenate([seen.by_eliminated, by_pose]),
            np.concatenate([seen.by_kept, by_kept]),
        )


@dataclass(frozen=True, eq=False)
class Steps:
    """Odometry of a whole run, for motions that walls do not determine.

    `motion` (i, 3): pose of each iteration in the frame of the previous one, without systematic
    errors: yaw, x, y; NaN if unknown. `variance` (i, 2): variance of the yaw, square radians, and
    of x and y, square metres. `needed` (i,): which motions it constrains. `hanging` (i,): which
    motions depend on it.
    """

    motion: Floats
    variance: Floats
    needed: Bools
    hanging: Bools

    def lengthened(self, motions: Floats) -> Floats:
        """Return motions (i, 3) from scan to scan, as long as odometry where they depend on it.

        During the run, their length was computed with the scale estimated until then.
        """
        way, found = np.hypot(*self.motion[:, 1:].T), motions.copy()
        own = np.hypot(*motions[:, 1:].T)
        rows = np.flatnonzero(self.hanging & np.isfinite(way) & (own > STILL_M))
        found[rows, 1:] *= (way[rows] / own[rows])[:, None]
        return found

    def between(self, iterations: Ints) -> MotionFactors:
        """Return the needed factors between these iterations (k,) and their successors."""
        needed = np.append(0, np.cumsum(self.needed))[iterations + 1]
        pairs = np.flatnonzero(np.diff(needed) > 0)
        both, motion, sd = [], [], []
        for k in pairs.tolist():
            rows = slice(iterations[k] + 1, iterations[k + 1] + 1)
            if np.isfinite(self.motion[rows]).all():
                both.append((k, k + 1))
                motion.append(path_of(self.motion[rows])[-1])
                sd.append(np.sqrt(self.variance[rows].sum(axis=0)))
        if not both:
            return MotionFactors()
        return MotionFactors(np.array(both), np.array(motion), np.array(sd))


def steps_of(
    noise: MotionNoise,
    given: Floats,
    n_measured: int,
    submaps: Sequence[tuple[slice, Floats]],
    hanging: Bools,
) -> Steps:
    """Return the odometry of a whole run for use in its map.

    Its noise is estimated over distances of at least `WAY_M` for which walls determine the motion:
    from scan to scan these are not more accurate.

    `noise`: combined noise of odometry and of the motions from scan to scan. `given` (i, 4, 4):
    odometry; NaN where it is rejected. `n_measured`: number of steps used for that estimate.
    `submaps`, sequence of (slice, (k, 4, 4)): the iterations of each and their poses; NaN for
    iterations of other submaps. `hanging` (i,): which motions depend on odometry.
    """
    steps, (sd_m, sd_rad) = corrected(noise, given), noise.sigmas(given)
    way = np.hypot(steps[:, 1], steps[:, 2])
    known = np.isfinite(way)
    typical_m = max(float(np.median(way[known])), STILL_M) if known.any() else STILL_M
    variance = np.column_stack([sd_rad**2, sd_m**2])
    over, true = _compared(steps, submaps, known & ~hanging)
    found, n, length = motion_noise(over, true), max(n_measured, 1), typical_m
    sd = np.array([noise.sigma_rad, noise.sigma_way * typical_m])
    if found is not None:
        length = float(np.median(np.hypot(*over[:, :2, 3].T)))
        n = max(round(way[known & ~hanging].sum() / length), 1)
        sd = np.array([found.sigma_rad, found.sigma_way * length])
        variance = np.maximum(way, STILL_M)[:, None] / length * sd**2
        steps = corrected(found, matrices(steps))
    # Systematic errors, unlike noise, grow linearly with the length of the run of steps that hang.
    run = np.cumsum(np.diff(hanging, prepend=False))
    together = np.bincount(run, np.nan_to_num(way) * hanging)[run]
    variance += (way * together)[:, None] * (sd / length) ** 2 / n
    beside = np.convolve(hanging, np.ones(2 * BESIDE + 1))[BESIDE : BESIDE + len(hanging)] > 0
    return Steps(steps, variance, beside & known, hanging)


def _compared(
    steps: Floats, submaps: Sequence[tuple[slice, Floats]], known: Bools
) -> tuple[Floats, Floats]:
    """Return motions (k, 4, 4) over `WAY_M` by steps (i, 3) and by the poses of submaps."""
    way, path = np.hypot(steps[:, 1], steps[:, 2]), matrices(path_of(np.nan_to_num(steps)))
    pairs = [(np.empty((0, 4, 4)), np.empty((0, 4, 4)))]
    for rows, poses in submaps:
        goes_on = known[rows] & np.isfinite(poses[:, 0, 0])
        goes_on[1:] &= np.isfinite(poses[:-1, 0, 0])
        gone = np.cumsum(np.nan_to_num(way[rows]))
        ends = np.searchsorted(gone, gone + WAY_M)
        broken = np.append(np.cumsum(~goes_on), len(gone) + 1)
        whole = broken[ends] == broken[:-1]
        a, b = np.flatnonzero(whole), ends[whole]
        given = path[rows]
        pairs.append((np.linalg.inv(given[a]) @ given[b], np.linalg.inv(poses[a]) @ poses[b]))
    over, true = (np.concatenate(each) for each in zip(*pairs, strict=True))
    return over, true


def constant_errors(steps: Floats, true: Floats) -> MotionNoise | None:
    """Return the constant errors of steps (k, 4, 4) with measured motions (k, 4, 4).

    They are compared over paths of `WAY_M` without leaps: jitter lengthens single steps, which
    biases the scale. None if the whole path is too short.
    """
    is_usual = ~leaps(steps, np.ones(len(steps), dtype=np.bool_))
    steps, true = steps[is_usual], true[is_usual]
    way_m = np.linalg.norm(steps[:, :2, 3], axis=1)
    if way_m.sum() < APART * WAY_M:
        return None
    return motion_noise(*stretches(steps, true, way_m, WAY_M))


def stretches(steps: Floats, true: Floats, way_m: Floats, length_m: float) -> tuple[Floats, Floats]:
    """Return odometry and measured motions over stretches of some length, both (s, 4, 4).

    Of steps (k, 4, 4) with measured motions (k, 4, 4), joined as if there were no others; `way_m`
    (k,): the lengths of the steps.
    """
    way = np.cumsum(way_m)
    end = np.searchsorted(way, way + length_m)
    a = np.flatnonzero(end < len(way))
    paths = [matrices(path_of(from_matrices(each))) for each in (steps, true)]
    given, measured = (np.linalg.inv(path[a]) @ path[end[a]] for path in paths)
    return given, measured


def corrected(noise: MotionNoise, steps: Floats) -> Floats:
    """Return planar steps (k, 4, 4) without the systematic errors (k, 3): yaw, x, y."""
    return from_matrices(noise.corrected(steps))


def path_of(steps: Floats) -> Floats:
    """Return the poses (k, 3) after steps (k, 3), in the frame before the first: yaw, x, y."""
    yaw = np.cumsum(steps[:, 0])
    c, s = np.cos(yaw - steps[:, 0]), np.sin(yaw - steps[:, 0])
    x, y = steps[:, 1:].T
    return np.column_stack([yaw, np.cumsum(c * x - s * y), np.cumsum(s * x + c * y)])
