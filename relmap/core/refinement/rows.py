"""The rows of the segments of one submap, prepared for the joint least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.refinement.condensing import SegmentRows


@dataclass(frozen=True, eq=False)
class JointRows:
    """Rows of segments that belong to one submap, numbered without gaps.

    `points` (n, d), segment frame, metres; `visible` (n,); `n_seen` (n,): number of observations of
    each row; `segment` (n,), ascending: 0 to s - 1; `landmark` (n,): 0 to m - 1; `landmarks` (m,):
    their numbers in the map; `segments` (s,): their numbers among all segments; `rows` (n,): their
    indices among all rows.
    """

    points: Floats
    visible: NDArray[np.uint8]
    n_seen: Floats
    segment: Ints
    landmark: Ints
    landmarks: Ints
    segments: Ints
    rows: Ints

    @classmethod
    def of_landmarks(cls, rows: SegmentRows, landmark: Ints, kept: Ints) -> JointRows:
        """Return the chosen rows `kept` (n,) of all rows, with landmarks (k,)."""
        landmarks, compact = numbered(landmark[kept])
        segments, segment = numbered(rows.segment[kept])
        return cls(
            rows.points[kept],
            rows.visible[kept],
            rows.n_seen[kept].astype(np.float64),
            segment,
            compact,
            landmarks,
            segments,
            kept,
        )

    @property
    def begin(self) -> Ints:
        """First row of each segment, and the end of the last; (s + 1,)."""
        return np.searchsorted(self.segment, np.arange(len(self.segments) + 1))


def numbered(values: Ints) -> tuple[Ints, Ints]:
    """Return the distinct values of (k,), ascending, and the index of each value among them."""
    there = np.zeros(int(values.max(initial=-1)) + 1, dtype=bool)
    there[values] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1)[values]
