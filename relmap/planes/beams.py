"""The end points of the beams of every scan, which tell what is seen through."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.state.growing import FEW, GrowingArray

PER_SCAN = 2000
"""Of more beams of a scan only one in so many is kept: a cloud has a hundred thousand."""


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
        rows = rows[:: max(-(-len(rows) // PER_SCAN), 1)]
        self._ends.extend(rows[np.isfinite(rows).all(axis=1)])
        self._offsets.extend(np.array([len(self._ends)]))

    def of(self, iteration: int) -> NDArray[np.float32]:
        """Return the end points (n, 2) of one scan."""
        begin, end = self._offsets.values[iteration : iteration + 2]
        return self._ends.values[begin:end]

    def placed(
        self, poses: NDArray[np.float64], span: tuple[int, int], most: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where beams of some scans begin and end by their poses, (n, 2) each.

        Parameters
        ----------
        poses : (k, 4, 4) float64
            ``T_map_robot`` of the scans of the span; what has none, NaN, is left out.
        span : (int, int)
            The first scan, and one after the last.
        most : int
            Of more beams only one in so many is returned.
        """
        offsets = self._offsets.values[span[0] : span[1] + 1]
        every = max(int(-(-(offsets[-1] - offsets[0]) // most)), 1)
        scan = np.repeat(np.arange(len(poses)), np.diff(offsets))[::every]
        ends = self._ends.values[offsets[0] : offsets[-1] : every].astype(np.float64)
        known = np.isfinite(poses[scan, 0, 0])
        T, ends = poses[scan[known]], ends[known]
        origin = T[:, :2, 3]
        return origin, np.einsum("nij,nj->ni", T[:, :2, :2], ends) + origin
