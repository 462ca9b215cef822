"""Every single observation of a run, kept only where somebody asks for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.refinement.rows import numbered
from relmap.core.state.growing import FEW, GrowingArray


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


class KeptObservations:
    """Keeps what is seen, as it is seen, for as long as the mapper lives."""

    STATE = "_landmark _points _iteration"

    def __init__(self) -> None:
        self._landmark: GrowingArray[np.int32] = GrowingArray(np.int32)
        self._points: GrowingArray[np.float64] = GrowingArray(np.float64, (0,), FEW)
        self._iteration: GrowingArray[np.int32] = GrowingArray(np.int32)

    def append(
        self, iteration: int, landmarks: NDArray[np.int64], points_robot: NDArray[np.float64]
    ) -> None:
        """Keep what one iteration saw: landmarks (n,), points (n, d)."""
        if not len(landmarks):
            return
        if not len(self._points):
            self._points = GrowingArray(np.float64, points_robot.shape[1:])
        self._landmark.extend(landmarks)
        self._points.extend(points_robot)
        self._iteration.extend(np.full(len(landmarks), iteration))

    def of_landmarks(
        self, landmarks: NDArray[np.int64], positions: NDArray[np.float64], of: NDArray[np.int64]
    ) -> Observations:
        """Return the observations of landmarks (m,) at positions (m, d).

        Parameters
        ----------
        landmarks : (m,) int64, ascending
        positions : (m, d) float64, metres
        of : (k,) int64
            The landmark that each number stands for, after merging.
        """
        number = np.full(len(of), -1)
        number[landmarks] = np.arange(len(landmarks))
        landmark = number[of[self._landmark.values]]
        rows = np.flatnonzero(landmark >= 0)
        seen = self._chosen(rows, landmark[rows])
        fixed = seen.placed_on(positions)[2][seen.iteration]
        return self._chosen(rows[fixed], landmark[rows[fixed]])

    def _chosen(self, rows: NDArray[np.int64], landmark: NDArray[np.int64]) -> Observations:
        iterations, iteration = numbered(self._iteration.values[rows].astype(np.int64))
        return Observations(self._points.values[rows], landmark, iteration, iterations)
