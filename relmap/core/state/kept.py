"""Observations that are kept one by one, for the refinement."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.state.growing import GrowingArray


class KeptObservations:
    """Every observation of a run with odometry, covariances, or unequal or large noise.

    Scans with too few landmarks to be condensed count too.  An observation takes 40 bytes in the
    plane and 48 in space, and its covariance another 32 or 72.  Observations that
    were condensed before the first odometry are means of `count` of them.
    """

    STATE = "_landmark _location _iteration _count _covariance"

    def __init__(self) -> None:
        self._landmark: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._location: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._iteration: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._count: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._covariance: GrowingArray[np.float64] = GrowingArray(np.float64, (0, 0))

    def __len__(self) -> int:
        """Return the number of observations."""
        return len(self._landmark)

    def append(
        self,
        landmark: Ints,
        location: Floats,
        iteration: int | Ints,
        covariance: Floats | None = None,
        count: float | Floats = 1.0,
    ) -> None:
        """Add n observations.

        `landmark` (n,): before merging, so that a merge can be undone; `location` (n, d), robot
        frame, metres; `iteration` (n,), or of all; `covariance` (n, d, d), square metres; `count`
        (n,), or of all: number of observations of which each is the mean.
        """
        self._landmark.extend(landmark)
        self._location.extend(location)
        self._iteration.extend(np.broadcast_to(iteration, len(landmark)))
        self._count.extend(np.broadcast_to(count, len(landmark)))
        if covariance is not None:
            self._covariance.extend(covariance)

    def weigh(self, covariance: Floats) -> None:
        """Replace the covariances of all n observations by others (n, d, d), square metres."""
        self._covariance.hold(covariance)

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
    def count(self) -> Floats:
        """Number of observations (n,) of which each is the mean."""
        return self._count.values

    @property
    def covariance(self) -> Floats:
        """Covariance of each observation (n, d, d), square metres; empty if unknown."""
        return self._covariance.values
