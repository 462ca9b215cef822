"""The noise of the observations, estimated from distances that no motion changes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class NoiseEstimate:
    """Pooled standard deviation of an observed coordinate.

    The distance of a member from the centre of its group is the same in every iteration, however
    the robot moves; how much it varies is the noise, seen along one direction.
    """

    def __init__(self) -> None:
        self._squares = 0.0
        self._freedoms = 0.0

    def add(self, block: NDArray[np.float64]) -> None:
        """Take in a group's observations (g, i, d), robot frame, metres."""
        g, n = block.shape[:2]
        radius = np.linalg.norm(block - block.mean(axis=0), axis=2)
        self._squares += float(np.sum((radius - radius.mean(axis=1, keepdims=True)) ** 2))
        # The centre holds 1/g of the member itself, which takes that share of its noise away.
        self._freedoms += (g - 1) * (n - 1)

    @property
    def sigma_m(self) -> float:
        """Standard deviation of one coordinate, metres; NaN before anything was seen twice."""
        return float(np.sqrt(self._squares / self._freedoms)) if self._freedoms else np.nan
