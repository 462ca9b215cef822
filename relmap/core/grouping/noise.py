"""The noise of the observations, estimated from distances that no motion changes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FORGETTING = 0.99
"""What each group leaves of the weight of those before: the noise may change on the way."""
LOWEST = 0.12
"""Share of pairs taken for static where nothing is known: a third of all landmarks make as many."""
RAISED = 1.5
"""What brings the variance at the upper end of that share to a typical one."""
RIGID = 1e-9
"""Deviation, as a share of a distance, below which it is one by construction."""
PAIRED = 40
"""Landmarks that a first guess looks at."""


class NoiseEstimate:
    """Standard deviation of an observed coordinate.

    The distance of a member from the centre of its group is the same in every iteration, however
    the robot moves; how much it varies is the noise, seen along one direction.  The median over
    the members keeps single outliers out; groups of movers must be kept out before.
    """

    STATE = "_squares _freedoms"

    def __init__(self) -> None:
        self._squares = 0.0
        self._freedoms = 0.0

    def restart(self) -> None:
        """Forget what was learnt: the noise has changed."""
        self._squares = self._freedoms = 0.0

    def add(self, block: NDArray[np.float64]) -> None:
        """Take in a group's observations (g, i, d), robot frame, metres."""
        g, n = block.shape[:2]
        freedoms = (g - 1) * (n - 1)
        if freedoms == 0:
            return
        from relmap.core.grouping.averaging_kernels import steady_variance

        typical = steady_variance(block, _chi_square_median(n - 1))
        self._squares = FORGETTING * self._squares + typical * freedoms
        self._freedoms = FORGETTING * self._freedoms + freedoms

    @property
    def sigma_m(self) -> float:
        """Standard deviation of one coordinate, metres; NaN before anything was seen twice."""
        return float(np.sqrt(self._squares / self._freedoms)) if self._freedoms else np.nan


def guess_noise(block: NDArray[np.float64]) -> float:
    """Estimate the noise of a block before its static landmarks are known.

    The distances between static landmarks deviate least, and they are a good share of all.

    Parameters
    ----------
    block : (n, i, d) float64, robot frame, metres
        NaN where a landmark was not seen.

    Returns
    -------
    float
        Standard deviation of one coordinate, metres; NaN where no two were seen together twice.
    """
    few = block[np.argsort(-np.isfinite(block[:, :, 0]).sum(axis=1), kind="stable")[:PAIRED]]
    a, b = np.triu_indices(len(few), k=1)
    distance = np.linalg.norm(few[a] - few[b], axis=2)
    n = np.isfinite(distance).sum(axis=1)
    often = 2 * n > n.max(initial=2)
    distance, n = distance[often], n[often]
    if not len(n):
        return np.nan
    mean = np.nansum(distance, axis=1) / n
    variance = np.nansum((distance - mean[:, None]) ** 2, axis=1) / (n - 1)
    rigid = variance <= (RIGID * mean) ** 2
    if 2 * rigid.sum() < len(rigid):  # parts of one thing, which no noise tells apart
        variance = variance[~rigid]
    return float(np.sqrt(RAISED * np.quantile(variance, LOWEST) / 2))


def _chi_square_median(freedoms: int) -> float:
    """Return the median of chi-square over its mean (Wilson and Hilferty, 1931)."""
    return float((1 - 2 / (9 * freedoms)) ** 3)
