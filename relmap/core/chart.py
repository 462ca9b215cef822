"""The point chart: which landmark was visible in which iteration (Figs 9 and 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.store import ObservationStore


@dataclass(frozen=True, eq=False)
class PointChart:
    """Visibility of landmarks over the iterations in which one of them, the seed, was visible.

    Attributes
    ----------
    landmarks : (n,) int64
        The seed first, then all that were visible together with it at least once.
    iterations : (i,) int64, ascending
        The iterations in which the seed was visible.
    visible : (n, i) bool
    """

    landmarks: NDArray[np.int64]
    iterations: NDArray[np.int64]
    visible: NDArray[np.bool_]

    @classmethod
    def around(cls, seed: int, store: ObservationStore, begin: int, end: int) -> PointChart:
        """Chart what was visible together with `seed` in iterations `begin` to `end` (Fig. 9)."""
        landmarks, iterations = store.seen(begin, end)
        when = iterations[landmarks == seed]
        column_of = np.full(end - begin, -1)
        column_of[when - begin] = np.arange(len(when))
        column = column_of[iterations - begin]
        landmarks, column = landmarks[column >= 0], column[column >= 0]
        present, row = np.unique(landmarks, return_inverse=True)
        visible = np.zeros((len(present), len(when)), dtype=bool)
        visible[row, column] = True
        first = np.argsort(present != seed, kind="stable")
        return cls(present[first], when, visible[first])

    def from_the_start(self) -> PointChart:
        """Return the chart of those that were visible in its first iteration."""
        rows = self.visible[:, 0]
        return PointChart(self.landmarks[rows], self.iterations, self.visible[rows])

    @property
    def common_interval(self) -> NDArray[np.int64]:
        """Number of iterations each landmark shares with the seed; (n,)."""
        return np.asarray(self.visible.sum(axis=1))

    def sorted_by_common_interval(self, preference: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the order (n,) with larger common intervals higher up, the seed on top (Fig. 10).

        Parameters
        ----------
        preference : (n,) float64
            Of landmarks with equal common intervals, the larger preference goes first.
        """
        others = 1 + np.lexsort((-preference[1:], -self.common_interval[1:]))
        return np.concatenate([[0], others])
