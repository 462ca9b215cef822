"""Which landmark a track turned out to be of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.growing import GrowingArray


class Identity:
    """Maps the number of each track to that of its landmark, which changes by merging."""

    def __init__(self) -> None:
        self._landmark_of: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._tracks_of: dict[int, list[int]] = {}

    def resize(self, n: int) -> None:
        """Let tracks 0 to n - 1 be landmarks of their own, where they are new."""
        self._landmark_of.extend(np.arange(len(self._landmark_of), n))

    def of(self, tracks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the landmarks (n,) that tracks (n,) are of."""
        return self._landmark_of.values[tracks]

    @property
    def own(self) -> NDArray[np.bool_]:
        """Whether each number is that of a landmark still, not merged into another; (n,)."""
        numbers = self._landmark_of.values
        return np.asarray(numbers == np.arange(len(numbers)))

    def merge(self, new: int, old: int) -> None:
        """Let all tracks of one landmark be of another."""
        tracks = [new, *self._tracks_of.pop(new, [])]
        self._landmark_of.values[tracks] = old
        self._tracks_of.setdefault(old, []).extend(tracks)
