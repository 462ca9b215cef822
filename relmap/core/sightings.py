"""When and how often each landmark was seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.growing import GrowingArray

NEVER = -(2**62)
"""Iteration in which a landmark not seen yet was last seen."""


class Sightings:
    """First and last iteration and number of observations of every landmark.

    Of one that was merged also each stretch between.
    """

    def __init__(self) -> None:
        self._first: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._last: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._counts: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._since: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._earlier: dict[int, list[list[int]]] = {}

    @property
    def first(self) -> NDArray[np.int64]:
        """Iteration in which each landmark was seen first; (n,)."""
        return self._first.values

    @property
    def last(self) -> NDArray[np.int64]:
        """Iteration in which each landmark was seen last, or `NEVER`; (n,)."""
        return self._last.values

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of observations of each landmark; (n,)."""
        return self._counts.values

    def resize(self, n: int, iteration: int) -> None:
        """Make room for landmarks 0 to n - 1, the new ones seen first in this iteration."""
        self._first.resize(n, iteration)
        self._last.resize(n, NEVER)
        self._counts.resize(n, 0)
        self._since.resize(n, iteration)

    def see(self, landmarks: NDArray[np.int64], iteration: int) -> None:
        """Note which landmarks are seen."""
        self.last[landmarks] = iteration
        self.counts[landmarks] += 1

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark go on in place of a new one, which turned out to be it."""
        self._earlier[old] = self._stretches(old) + self._earlier.pop(new, [])
        self._since.values[old] = self._since.values[new]
        self.first[old] = min(self.first[old], self.first[new])
        self.last[old] = self.last[new]
        self.counts[old] += self.counts[new]

    def is_later(self, new: int, old: int) -> bool:
        """Tell whether one landmark was seen after another was last, and never while it was."""
        if self.last[old] < self.first[new]:
            return True
        if self.last[old] >= self.last[new] or not (new in self._earlier or old in self._earlier):
            return False
        return not any(
            begin <= other_end and other_begin <= end
            for begin, end in self._stretches(new)
            for other_begin, other_end in self._stretches(old)
        )

    def _stretches(self, landmark: int) -> list[list[int]]:
        """Return the first and last iteration of each stretch in which a landmark was seen."""
        present = [int(self._since.values[landmark]), int(self.last[landmark])]
        return [*self._earlier.get(landmark, []), present]
