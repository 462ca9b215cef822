"""The spacing and the noise of landmarks, estimated from the scans themselves."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import middle, nearest
from relmap.core.association.metric import MEMORY, RayNoise

COARSE = 0.1
"""Tolerance before the noise is known, in spacings."""
FINER = (0.1, 0.3)
"""Multiples of it that are tried first; on a lattice a coarse tolerance has rivals."""
WIDER = (2.0, 3.5)
"""Multiples of it that are tried last."""
SIGMAS, FEW_SIGMAS = 4.5, 3.0
"""Tolerance once the noise is known, in standard deviations; and if that is large compared with the
spacing."""
SHARP = 0.16
"""Tolerance, in spacings, up to which single matches are hardly ambiguous."""
WIDEST = 0.5
"""Largest tolerance, in spacings."""
EXACT = 1e-3
"""Minimum tolerance, in spacings, for noise-free data."""
FAINT = 0.01
"""Minimum noise, in spacings, tried when the estimate may be too small."""
FEW = 3
"""Maximum number of links that give no noise estimate."""
SLOWNESS = 0.1
"""Weight of the latest iteration in the estimates of spacing and noise."""
CHI2_MEDIAN = {2: 1.386, 3: 2.366}
"""Median of a sum of d squared standard normals."""


class Scale:
    """Spacing and noise of the landmarks, the tolerances derived from them, and the robot's step.

    `spacing_m`: typical distance between neighbours, metres; infinite before it is known.
    `noise_m`: standard deviation of the difference of a coordinate between two scans; None if
    unknown. `wider`: factor by which the tolerance is wider before the noise is known. `step_m`:
    longest step of the robot from one scan to the next, metres. `rays`: noise as a function of
    direction and distance.
    """

    spacing_m: float
    noise_m: float | None
    wider: float
    step_m: float
    rays: RayNoise
    STATE = "spacing_m noise_m wider step_m rays"

    def __init__(self) -> None:
        self.spacing_m = np.inf
        self.noise_m = None
        self.wider = 1.0
        self.step_m = 0.0
        self.rays = RayNoise()

    @property
    def tolerance_m(self) -> float:
        """Largest distance between matches that agree."""
        coarse = COARSE * self.spacing_m
        if self.noise_m is None:
            return coarse * self.wider
        wanted = max(SIGMAS * self.noise_m, EXACT * self.spacing_m)
        if wanted <= 1.5 * coarse:
            return wanted
        few = min(FEW_SIGMAS * self.noise_m, WIDEST * self.spacing_m)
        return min(wanted, max(1.5 * coarse, few))

    @property
    def is_sharp(self) -> bool:
        """Whether single matches are hardly ambiguous."""
        return self.tolerance_m <= SHARP * self.spacing_m

    @property
    def is_blurred(self) -> bool:
        """Whether the noise is known and many single matches are ambiguous."""
        return self.noise_m is not None and not self.is_sharp and math.isfinite(self.spacing_m)

    @property
    def assumed_m(self) -> float:
        """The noise, or that for which the minimum tolerance is meant if it is less."""
        return max(self.noise_m or 0.0, EXACT / SIGMAS * self.spacing_m)

    def variances(self, n_seen: Ints) -> Floats:
        """Return the variances (n,) of a coordinate's difference, square metres.

        Between tracks, given their numbers of observations (n,), and the next observation.
        """
        share = (1 + 1 / np.minimum(n_seen, MEMORY)) / (1 + 1 / MEMORY)
        return np.asarray(share * self.assumed_m**2)

    @property
    def gate_m(self) -> float:
        """Largest distance of an observation from the predicted track."""
        tolerance_m = self.tolerance_m
        return max(tolerance_m, min(2 * tolerance_m, 0.8 * COARSE * self.spacing_m))

    def allow_noise(self) -> None:
        """Allow for a noise estimate that is too small."""
        if self.noise_m is not None:
            self.noise_m = max(self.noise_m, FAINT * self.spacing_m)

    def learn(self, middle_square: float, n: int, d: int) -> None:
        """Update the noise of a coordinate's difference from links of n static landmarks.

        `middle_square`: upper median of their squared misfits in d dimensions, in the metric of the
        observations.
        """
        if n > FEW and not self.is_blurred:
            variance = middle_square / CHI2_MEDIAN[d] * n * d / (n * d - d * (d + 1) / 2)
            self._learn_variance(variance)

    def learn_misfit(self, misfit: float) -> None:
        """Update the noise from the variance of ambiguous matches, relative to that assumed."""
        if self.noise_m is not None:
            self._learn_variance(misfit * self.noise_m**2)

    def _learn_variance(self, variance: float) -> None:
        before = variance if self.noise_m is None else self.noise_m**2
        self.noise_m = math.sqrt(before + SLOWNESS * (variance - before))


def spacing_of(points: Floats) -> float:
    """Return the median distance of points (n, d) to their nearest neighbours, metres.

    If many stand in pairs, such as the two edges of a post, it is at least a fraction (1 /
    `PAIR_RATIO`) of the lower quartile of the distances to the second neighbour. If most coincide
    with others, each place counts once.
    """
    from relmap.core.association.matching_kernels import MANY, PAIR_RATIO

    if len(points) < 2:
        return np.inf
    apart = nearest(cKDTree(points), points, 3 if len(points) >= MANY else 2)[0]
    pairs = [np.sort(of)[len(points) // 4] / PAIR_RATIO for of in apart[:, 2:].T]
    return float(max([middle(apart[:, 1]), *pairs])) or spacing_of(np.unique(points, axis=0))
