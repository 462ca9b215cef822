"""The end points of the beams of every scan, which tell what is seen through."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.state.growing import FEW, GrowingArray


class Beams:
    """End points of beams in the robot frame, scan after scan, in single precision."""

    _ends: GrowingArray[np.float32]
    _offsets: GrowingArray[np.int64]
    STATE = "_ends _offsets"

    def __init__(self) -> None:
        self._ends = GrowingArray(np.float32, (2,))
        self._offsets = GrowingArray(np.int64, room=FEW)
        self._offsets.extend(np.zeros(1, dtype=np.int64))

    def append(self, ends: Any) -> None:
        """Store those of one scan: (n, 2) or more columns, metres; None where there are none."""
        rows = np.empty((0, 2)) if ends is None else np.asarray(ends)[:, :2]
        self._ends.extend(rows[np.isfinite(rows).all(axis=1)])
        self._offsets.extend(np.array([len(self._ends)]))

    def of(self, iteration: int) -> NDArray[np.float32]:
        """Return the end points (n, 2) of one scan."""
        begin, end = self._offsets.values[iteration : iteration + 2]
        return self._ends.values[begin:end]

    def within(self, span: tuple[int, int], most: int) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """Return end points (n, 2) of a span of scans and the iteration (n,) of each.

        Of more than `most` only one in so many.
        """
        offsets = self._offsets.values[span[0] : span[1] + 1]
        every = max(int(-(-(offsets[-1] - offsets[0]) // most)), 1)
        iteration = np.repeat(np.arange(*span), np.diff(offsets))
        return self._ends.values[offsets[0] : offsets[-1] : every], iteration[::every]
