"""Observations with covariances, kept one by one for the refinement."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.state.growing import GrowingArray


class WeighedObservations:
    """Every observation of a run that comes with covariances; empty in other runs.

    Segments cannot represent covariances that differ between observations.  An observation takes
    72 bytes in the plane and 112 in space.
    """

    STATE = "_landmark _location _covariance _iteration"

    def __init__(self) -> None:
        self._landmark: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._location: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._covariance: GrowingArray[np.float64] = GrowingArray(np.float64, (0, 0))
        self._iteration: GrowingArray[np.int64] = GrowingArray(np.int64)

    def __len__(self) -> int:
        """Return the number of observations."""
        return len(self._landmark)

    def append(self, landmark: Ints, location: Floats, covariance: Floats, iteration: int) -> None:
        """Add n observations of landmarks (n,) at (n, d), robot frame, metres.

        Parameters
        ----------
        landmark : (n,) int64
            Before merging, so that a merge can be undone.
        location : (n, d) float64, robot frame, metres
        covariance : (n, d, d) float64, square metres
        iteration : int
        """
        if not len(self):
            d = location.shape[1]
            self._location = GrowingArray(np.float64, (d,))
            self._covariance = GrowingArray(np.float64, (d, d))
        self._landmark.extend(landmark)
        self._location.extend(location)
        self._covariance.extend(covariance)
        self._iteration.extend(np.full(len(landmark), iteration))

    def variances(self, landmarks: Ints, begin: int, end: int, landmark_of: Ints) -> Floats:
        """Return the mean variance (k,) of a coordinate of landmarks (k,), square metres.

        Parameters
        ----------
        landmarks : (k,) int64
            Seen in iterations `begin` to `end`.
        begin, end : int
        landmark_of : (m,) int64
            The landmark that each number stands for, after merging.
        """
        rows = slice(*np.searchsorted(self.iteration, [begin, end]))
        order = np.argsort(landmarks)
        seen = landmark_of[self.landmark[rows]]
        at = np.searchsorted(landmarks[order], seen).clip(0, len(landmarks) - 1)
        own = landmarks[order][at] == seen
        each = np.trace(self.covariance[rows][own], axis1=1, axis2=2) / self.location.shape[1]
        at = order[at[own]]
        counts = np.bincount(at, minlength=len(landmarks))
        total = np.bincount(at, each, minlength=len(landmarks))
        return np.asarray(total / np.maximum(counts, 1))

    @property
    def landmark(self) -> Ints:
        """Landmark of each observation (n,), as numbered when it was seen."""
        return self._landmark.values

    @property
    def iteration(self) -> Ints:
        """Iteration of each observation (n,), ascending."""
        return self._iteration.values

    @property
    def location(self) -> Floats:
        """Position of each observation (n, d), robot frame, metres."""
        return self._location.values

    @property
    def covariance(self) -> Floats:
        """Covariance of each observation (n, d, d), robot frame, square metres."""
        return self._covariance.values
