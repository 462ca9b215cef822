"""Observations with covariances, kept one by one for the refinement."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.state.growing import GrowingArray
from relmap.core.state.kept import SingleObservations


class WeighedObservations(SingleObservations):
    """Every observation of a run that comes with covariances; empty in other runs.

    Segments cannot represent covariances that differ between observations.  An observation takes
    72 bytes in the plane and 112 in space.
    """

    STATE = "_landmark _location _covariance _iteration"

    def __init__(self) -> None:
        super().__init__()
        self._covariance: GrowingArray[np.float64] = GrowingArray(np.float64, (0, 0))

    def append(self, landmark: Ints, location: Floats, covariance: Floats, iteration: int) -> None:
        """Add n observations of landmarks (n,) at (n, d), robot frame, metres.

        `landmark` (n,): before merging, so that a merge can be undone; `location` (n, d), robot
        frame, metres; `covariance` (n, d, d), square metres.
        """
        if not len(self):
            self._covariance = GrowingArray(np.float64, covariance.shape[1:])
        self._add(landmark, location, iteration)
        self._covariance.extend(covariance)

    def variances(self, landmarks: Ints, begin: int, end: int, landmark_of: Ints) -> Floats:
        """Return the mean variance (k,) of a coordinate of landmarks (k,), square metres.

        `landmarks` (k,): seen in iterations `begin` to `end`; `landmark_of` (m,): the landmark that
        each number stands for, after merging.
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
    def covariance(self) -> Floats:
        """Covariance of each observation (n, d, d), robot frame, square metres."""
        return self._covariance.values
