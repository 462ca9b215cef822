"""When and how often each landmark was seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.growing import GrowingArray

NEVER = -(2**62)
"""Iteration in which a landmark not seen yet was last seen."""


class Sightings:
    """First and last iteration and number of observations of every landmark."""

    def __init__(self) -> None:
        self._first: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._last: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._counts: GrowingArray[np.int64] = GrowingArray(np.int64)

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

    def see(self, landmarks: NDArray[np.int64], iteration: int) -> None:
        """Note which landmarks are seen."""
        self.last[landmarks] = iteration
        self.counts[landmarks] += 1

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark go on in place of a new one, which turned out to be it."""
        self.last[old] = self.last[new]
        self.counts[old] += self.counts[new]
