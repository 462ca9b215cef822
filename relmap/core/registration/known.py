"""Registration where the ids of the landmarks come with the observations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.growing import GrowingArray
from relmap.core.registration.base import UNIDENTIFIED


class KnownAssociation:
    """Takes the landmarks' ids as given."""

    def __init__(self) -> None:
        self._landmark_of: dict[int, int] = {}
        self._labels: GrowingArray[np.int64] = GrowingArray(np.int64)

    def labels_of(self, landmarks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the ids of landmarks (n,)."""
        return self._labels.values[landmarks]

    def match(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Return the landmark of each id (n,); negative ids are of none."""
        known = np.empty(0, dtype=np.int64) if ids is None else ids
        new = [i for i in known.tolist() if i >= 0 and i not in self._landmark_of]
        for number, label in enumerate(new, start=len(self._labels)):
            self._landmark_of[label] = number
        self._labels.extend(np.array(new, dtype=np.int64))
        found = (self._landmark_of.get(i, UNIDENTIFIED) for i in known.tolist())
        return np.fromiter(found, dtype=np.int64, count=len(known))
