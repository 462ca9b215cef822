"""The point chart: which landmark was visible in which iteration (Figs 9 and 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.state.store import ObservationStore


@dataclass(frozen=True, eq=False)
class PointChart:
    """Landmarks over the iterations in which one of them, the seed, was visible.

    Attributes
    ----------
    landmarks : (n,) int64
        The seed first, then all that were visible together with it at least once.
    iterations : (i,) int64, ascending
        The iterations in which the seed was visible.
    points_robot : (n, i, d) float64, robot frame, metres
        The observations; NaN where a landmark was not seen.
    visible : (n, i) bool
    variance : (n,) float64, square metres, optional
        Of an observed coordinate, where covariances came with the observations.
    """

    landmarks: Ints
    iterations: Ints
    points_robot: Floats
    visible: Bools
    variance: Floats | None = None

    @classmethod
    def around(cls, seed: int, store: ObservationStore, begin: int, end: int) -> PointChart:
        """Chart what was visible together with `seed` in iterations `begin` to `end` (Fig. 9)."""
        landmarks, iterations, block = store.seen_with(seed, begin, end)
        return cls(landmarks, iterations, block, np.isfinite(block[:, :, 0]))

    def only(self, rows: Bools) -> PointChart:
        """Return the chart of some of its landmarks, the seed among them."""
        return PointChart(
            self.landmarks[rows],
            self.iterations,
            self.points_robot[rows],
            self.visible[rows],
            None if self.variance is None else self.variance[rows],
        )

    @property
    def common_interval(self) -> Ints:
        """Number of iterations each landmark shares with the seed; (n,)."""
        return np.asarray(self.visible.sum(axis=1))

    def sorted_by_common_interval(self, rows: Ints, preference: Floats) -> Ints:
        """Return the order of some rows (k,) with larger common intervals higher up (Fig. 10).

        The seed shares all its iterations with itself, so it comes out on top.

        Parameters
        ----------
        rows : (k,) int64
        preference : (k,) float64
            Of rows with equal common intervals, the larger preference goes first.
        """
        return np.lexsort((-preference, -self.common_interval[rows]))
