"""Observations that are kept one by one, for the refinement."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.state.growing import GrowingArray


class SingleObservations:
    """Observations one by one, by the number under which they were made."""

    def __init__(self) -> None:
        self._landmark: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._location: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._iteration: GrowingArray[np.int64] = GrowingArray(np.int64)

    def __len__(self) -> int:
        """Return the number of observations."""
        return len(self._landmark)

    def _add(self, landmark: Ints, location: Floats, iteration: int) -> None:
        if not len(self):
            self._location = GrowingArray(np.float64, location.shape[1:])
        self._landmark.extend(landmark)
        self._location.extend(location)
        self._iteration.resize(len(self._landmark), iteration)

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


class KeptObservations(SingleObservations):
    """Every observation of a run with odometry.

    Scans with too few landmarks to be condensed count too.  An observation takes 40 bytes in the
    plane and 48 in space.  Observations that were condensed before the first odometry are means of
    `count` of them.
    """

    STATE = "_landmark _location _iteration _count"

    def __init__(self) -> None:
        super().__init__()
        self._count: GrowingArray[np.float64] = GrowingArray(np.float64)

    @property
    def count(self) -> Floats:
        """Number of observations (n,) of which each is the mean."""
        return self._count.values

    def append(self, landmark: Ints, location: Floats, iteration: int) -> None:
        """Add n observations of landmarks (n,) at (n, d), robot frame, metres."""
        self._add(landmark, location, iteration)
        self._count.resize(len(self), 1.0)

    def begin_with(self, landmark: Ints, location: Floats, iteration: Ints, count: Floats) -> None:
        """Replace all by n earlier observations; the arguments are the columns."""
        self._landmark.hold(landmark)
        self._location.hold(location)
        self._iteration.hold(iteration)
        self._count.hold(count)


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
