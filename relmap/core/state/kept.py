"""Every observation of a run, where segments do not say all that it says."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.state.growing import GrowingArray


class KeptObservations:
    """Every observation of a run with odometry, by the number under which it was made.

    Scans that see too little to be condensed count there.  That takes 32 bytes for each in the
    plane and 40 in space.
    """

    STATE = "_landmark _location _iteration"

    def __init__(self) -> None:
        self._landmark: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._location: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._iteration: GrowingArray[np.int64] = GrowingArray(np.int64)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._landmark)

    def append(self, landmark: Ints, location: Floats, iteration: int) -> None:
        """Take in n observations of landmarks (n,) at (n, d), robot frame, metres."""
        if not len(self):
            self._location = GrowingArray(np.float64, location.shape[1:])
        self._landmark.extend(landmark)
        self._location.extend(location)
        self._iteration.extend(np.full(len(landmark), iteration))

    @property
    def landmark(self) -> Ints:
        """Of which landmark each is (n,), as numbered when it was seen."""
        return self._landmark.values

    @property
    def iteration(self) -> Ints:
        """When each was made (n,), ascending."""
        return self._iteration.values

    @property
    def location(self) -> Floats:
        """Where each was seen (n, d), robot frame, metres."""
        return self._location.values
