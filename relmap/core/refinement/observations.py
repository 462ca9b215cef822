"""Every single observation of a run, as far as its landmarks are refined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.refinement.rows import numbered
from relmap.core.state.store import ObservationStore


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations of some landmarks, by iterations that these fix.

    Attributes
    ----------
    points : (n, d) float64, robot frame, metres
    landmark : (n,) int64
        0 to m - 1.
    iteration : (n,) int64, ascending
        0 to k - 1.
    iterations : (k,) int64
        Their numbers in the run.
    """

    points: NDArray[np.float64]
    landmark: NDArray[np.int64]
    iteration: NDArray[np.int64]
    iterations: NDArray[np.int64]

    @property
    def begin(self) -> NDArray[np.int64]:
        """Where the rows of each iteration begin, and where the last ends; (k + 1,)."""
        return np.searchsorted(self.iteration, np.arange(len(self.iterations) + 1))

    def placed_on(
        self, positions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return the placement of each iteration that fits landmarks (m, d) best.

        Returns
        -------
        R : (k, d, d) float64
        t : (k, d) float64
        fixed : (k,) bool
            Whether what was seen fixes it.
        """
        there, unit = positions[self.landmark], np.ones(len(self.points))
        return fit_rigid_each(self.points, there, unit, self.iteration, len(self.iterations))


def observations_of(
    store: ObservationStore,
    landmarks: NDArray[np.int64],
    positions: NDArray[np.float64],
    of: NDArray[np.int64],
) -> Observations:
    """Return the observations of landmarks (m,) at positions (m, d).

    Parameters
    ----------
    store : ObservationStore
        Of points; it keeps all of them.
    landmarks : (m,) int64, ascending
    positions : (m, d) float64, metres
    of : (k,) int64
        The landmark that each number stands for, after merging.
    """
    number = np.full(len(of), -1)
    number[landmarks] = np.arange(len(landmarks))
    seen, when = store.seen(0, store.n_iterations)
    landmark = number[of[seen]]
    rows = np.flatnonzero(landmark >= 0)
    points, landmark, when = store.points(0, store.n_iterations)[rows], landmark[rows], when[rows]
    every = _observations(points, landmark, when)
    fixed = every.placed_on(positions)[2][every.iteration]
    return _observations(points[fixed], landmark[fixed], when[fixed])


def _observations(
    points: NDArray[np.float64], landmark: NDArray[np.int64], when: NDArray[np.int64]
) -> Observations:
    iterations, iteration = numbered(when)
    return Observations(points, landmark, iteration, iterations)
