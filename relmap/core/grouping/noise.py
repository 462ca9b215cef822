"""Noise of the observations, estimated from motion-invariant distances."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats

FORGETTING = 0.99
"""Decay of the weight of earlier groups: the noise may change during a run."""
LOWEST = 0.12
"""Fraction of pairs assumed static if nothing is known: a third of all landmarks gives as many."""
RAISED = 1.8
"""Factor from the variance at the upper end of that fraction to a typical one."""
RIGID = 1e-9
"""Deviation, as a fraction of a distance, below which the distance is exact by construction."""
MEMBERS = 64
"""Maximum number of members of a group used; more would hardly improve the estimate."""
PAIRED = 40
"""Number of landmarks used for a first guess."""


class NoiseEstimate:
    """Running estimate of the standard deviation of an observed coordinate.

    The distance of a member from the centre of its group does not depend on the robot's motion; its
    variance is the noise along one direction. The median over the members rejects single outliers;
    groups of moving landmarks must be excluded by the caller.

    `least_m`: lower limit, metres, from what the observations say of their noise.
    """

    STATE = "_squares _freedoms least_m"

    def __init__(self) -> None:
        self._squares = 0.0
        self._freedoms = 0.0
        self.least_m = 0.0

    def restart(self) -> None:
        """Forget the estimate: the noise has changed."""
        self._squares = self._freedoms = 0.0

    def limit(self, least_m: float) -> None:
        """Take the least noise of another scan, metres, into the mean of those so far; 0: none."""
        share = 1 - FORGETTING if self.least_m else 1.0
        self.least_m += share * (least_m - self.least_m) if least_m else 0.0

    def add(self, block: Floats) -> None:
        """Add a group's observations (g, i, d), robot frame, metres."""
        few = np.ascontiguousarray(block[:: -(-len(block) // MEMBERS)])
        g, n = few.shape[:2]
        freedoms = (g - 1) * (n - 1)
        if freedoms == 0:
            return
        import relmap.core.grouping.averaging_kernels as kernels

        # The median of chi-square over its mean (Wilson and Hilferty, 1931).
        typical = kernels.steady_variance(few, (1 - 2 / (9 * (n - 1))) ** 3)
        self._squares = FORGETTING * self._squares + typical * freedoms
        self._freedoms = FORGETTING * self._freedoms + freedoms

    @property
    def sigma_m(self) -> float:
        """Standard deviation of one coordinate, metres; NaN before any repeated observation."""
        if not self._freedoms:
            return np.nan
        return max(float(np.sqrt(self._squares / self._freedoms)), self.least_m)


def guess_noise(block: Floats) -> float:
    """Estimate the noise of a block before its static landmarks are known.

    Distances between static landmarks vary least, and they are a good fraction of all distances.

    `block` (n, i, d), robot frame, metres: NaN where missing. Returns the standard deviation of one
    coordinate, metres; NaN if no two were seen together twice.
    """
    few = block[np.argsort(-np.isfinite(block[:, :, 0]).sum(axis=1), kind="stable")[:PAIRED]]
    a, b = np.triu_indices(len(few), k=1)
    distance = np.linalg.norm(few[a] - few[b], axis=2)
    known = np.isfinite(distance)
    n = known.sum(axis=1)
    often = 2 * n > n.max(initial=2)
    distance, known, n = distance[often], known[often], n[often]
    if not len(n):
        return np.nan
    mean = np.nansum(distance, axis=1) / n
    # Half of the squared steps are the variance of noise, but not of motion (von Neumann, 1941).
    latest = np.maximum.accumulate(np.where(known, np.arange(known.shape[1]), -1), axis=1)[:, :-1]
    before = np.where(latest >= 0, np.take_along_axis(distance, latest, axis=1), np.nan)
    variance = np.nansum((distance[:, 1:] - before) ** 2, axis=1) / (2 * (n - 1))
    rigid = variance <= (RIGID * mean) ** 2
    if 2 * rigid.sum() < len(rigid):  # parts of one object, which are not informative
        variance = variance[~rigid]
    return float(np.sqrt(RAISED * np.quantile(variance, LOWEST) / 2))
