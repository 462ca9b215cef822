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

    Attributes
    ----------
    points : (n, d) float64, segment frame, metres
    visible : (n,) uint8
    n_seen : (n,) float64
        Number of observations of each row.
    segment : (n,) int64, ascending
        0 to s - 1.
    landmark : (n,) int64
        0 to m - 1.
    landmarks : (m,) int64
        Their numbers in the map.
    segments : (s,) int64
        Their numbers among all segments.
    rows : (n,) int64
        Their indices among all rows.
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


def rows_of_each(landmark: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the first row of each of n landmarks (n + 1,) in a list of rows (k,)."""
    counts = np.bincount(landmark, minlength=n)
    return np.concatenate([[0], np.cumsum(counts)]), np.argsort(landmark, kind="stable")


def levels_of(begin: Ints, landmark: Ints, n_landmarks: int) -> tuple[Ints, Ints]:
    """Return levels of landmarks (m,) and of segments (s,), starting at an outer landmark.

    Neighbours are at most one level apart.

    Parameters
    ----------
    begin : (s + 1,) int64
        First row of each segment or iteration.
    landmark : (n,) int64
        Landmark of each row, 0 to `n_landmarks` - 1.
    n_landmarks : int
    """
    from relmap.core.refinement.levels_kernels import breadth_first

    graph = begin, landmark, *rows_of_each(landmark, n_landmarks)
    segment = np.repeat(np.arange(len(begin) - 1), np.diff(begin))
    of_landmark, of_segment = breadth_first(0, *graph, segment)
    of_landmark, of_segment = breadth_first(int(np.argmax(of_landmark)), *graph, segment)
    # At the end of a component, its last landmarks may be a level beyond its last segments.
    return of_landmark, numbered(of_segment)[1]


def numbered(values: Ints) -> tuple[Ints, Ints]:
    """Return the distinct values of (k,), ascending, and the index of each value among them."""
    there = np.zeros(int(values.max(initial=-1)) + 1, dtype=bool)
    there[values] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1)[values]
