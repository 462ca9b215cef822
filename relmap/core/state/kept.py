"""Every observation of a run, for refinement with odometry."""

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
