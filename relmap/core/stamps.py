"""Times of the scans of a run."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.scan import numbers
from relmap.core.state.growing import GrowingArray

MAX_S = 1e12
"""Larger times are not in seconds."""


class Stamps:
    """The time of each scan of a run, seconds; NaN for scans without."""

    STATE = "_stamps"

    def __init__(self) -> None:
        self._stamps: GrowingArray[np.float64] = GrowingArray(np.float64)

    @property
    def latest_s(self) -> float:
        """The latest time; minus infinity if there is none."""
        return float(self._stamps.values[-1]) if len(self._stamps) else -np.inf

    def checked(self, stamp_s: ArrayLike) -> float:
        """Return the time of the next scan.

        Raises `RelmapError` if it is not one number, beyond `MAX_S`, or not after the latest one.
        """
        wanted = f"one finite number of seconds, at most {MAX_S:g}"
        array = numbers(stamp_s, "stamp_s", wanted, 0.0)
        if array.shape or not abs(array) <= MAX_S:
            raise RelmapError(f"stamp_s is {array.tolist()!s:.40}; it must be {wanted}")
        if array <= self.latest_s:
            raise RelmapError(
                f"stamp_s is {array}, and an earlier scan had {self.latest_s}: "
                "give scans in the order of time"
            )
        return float(array)

    def append(self, stamp_s: float | None, iteration: int) -> None:
        """Add the time of an iteration, as checked; None if unknown."""
        if stamp_s is not None:
            self._stamps.resize(iteration, np.nan)
            self._stamps.append(stamp_s)

    def of(self, n_iterations: int) -> Floats:
        """Return the time of each iteration (n_iterations,); NaN if unknown."""
        missing = np.full(n_iterations - len(self._stamps), np.nan)
        return np.concatenate([self._stamps.values, missing])
