"""The global map: where the relative maps of the groups come together (section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid, fixes_rotation
from relmap.core.growing import GrowingArray


class GlobalMap:
    """Positions of landmarks in one frame, each the average over the groups that placed it."""

    def __init__(self) -> None:
        self._positions: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._weights: GrowingArray[np.float64] = GrowingArray(np.float64)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Position of each landmark (n, d), map frame, metres; NaN where it is not mapped."""
        return self._positions.values

    @property
    def weights(self) -> NDArray[np.float64]:
        """Number of iterations averaged into each landmark (n,); 0 where it is not mapped."""
        return self._weights.values

    @property
    def is_empty(self) -> bool:
        """Whether nothing is mapped yet."""
        return not self.weights.any()

    def resize(self, n: int, dimension: int) -> None:
        """Make room for landmarks 0 to n - 1 of that many coordinates, the new ones not mapped."""
        if not len(self._positions):
            self._positions = GrowingArray(np.float64, (dimension,))
        self._positions.resize(n, np.nan)
        self._weights.resize(n, 0.0)

    def align(
        self,
        landmarks: NDArray[np.int64],
        relative_map: NDArray[np.float64],
        n_iterations: int,
    ) -> NDArray[np.float64] | None:
        """Fit a group's relative map to those of its members that are mapped.

        Each counts with the number of iterations behind its two positions, the one in the map and
        the one in the group: variances add, so the weights add in parallel.

        Parameters
        ----------
        landmarks : (g,) int64
        relative_map : (g, d) float64, group frame, metres
        n_iterations : int
            Iterations averaged into the relative map.

        Returns
        -------
        (g, d) float64, map frame, metres, or None where the mapped members fix no rotation
        """
        shared = self.weights[landmarks] > 0
        placed = self.positions[landmarks[shared]]
        if not fixes_rotation(placed):
            return None
        weights = 1 / (1 / self.weights[landmarks[shared]] + 1 / n_iterations)
        R, t = fit_rigid(relative_map[shared], placed, weights)
        return relative_map @ R.T + t

    def average_in(
        self,
        landmarks: NDArray[np.int64],
        positions: NDArray[np.float64],
        weights: NDArray[np.float64],
    ) -> None:
        """Average positions (g, d) into the map; weights (g,) in iterations not used before."""
        old = self.weights[landmarks]
        total = old + weights
        here = np.where(old[:, None] > 0, self.positions[landmarks], positions)
        share = np.divide(weights, total, out=np.zeros_like(total), where=total > 0)
        self.positions[landmarks] = here + share[:, None] * (positions - here)
        self.weights[landmarks] = total
