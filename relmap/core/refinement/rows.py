"""What segments say of the landmarks of one submap, ready for the joint least squares."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from relmap.core.refinement.condensing import SegmentRows

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class JointRows:
    """Rows of segments that belong to one submap, numbered without gaps.

    Attributes
    ----------
    points : (n, d) float64, segment frame, metres
    visible : (n,) uint8
    n_seen : (n,) int64
    segment : (n,) int64, ascending
        0 to s - 1.
    landmark : (n,) int64
        0 to m - 1.
    landmarks : (m,) int64
        Their numbers in the map.
    segments : (s,) int64
        Their numbers among all segments.
    rows : (n,) int64
        Where these are among all rows.
    """

    points: NDArray[np.float64]
    visible: NDArray[np.uint8]
    n_seen: NDArray[np.int64]
    segment: NDArray[np.int64]
    landmark: NDArray[np.int64]
    landmarks: NDArray[np.int64]
    segments: NDArray[np.int64]
    rows: NDArray[np.int64]

    @classmethod
    def of_landmarks(
        cls,
        rows: SegmentRows,
        landmark: NDArray[np.int64],
        kept: NDArray[np.int64],
    ) -> JointRows:
        """Return chosen rows `kept` (n,), where all rows are of landmarks (k,)."""
        landmarks, compact = numbered(landmark[kept])
        segments, segment = numbered(rows.segment[kept])
        return cls(
            rows.points[kept],
            rows.visible[kept],
            rows.n_seen[kept],
            segment,
            compact,
            landmarks,
            segments,
            kept,
        )

    @property
    def begin(self) -> NDArray[np.int64]:
        """Where the rows of each segment begin, and where the last ends; (s + 1,)."""
        return np.searchsorted(self.segment, np.arange(len(self.segments) + 1))


def rows_of_each(
    landmark: NDArray[np.int64], n: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where the rows of each of n landmarks begin (n + 1,) in a list of rows (k,)."""
    counts = np.bincount(landmark, minlength=n)
    return np.concatenate([[0], np.cumsum(counts)]), np.argsort(landmark, kind="stable")


def searched(
    start: int,
    begin: NDArray[np.int64],
    landmark: NDArray[np.int64],
    by_landmark: tuple[NDArray[np.int64], NDArray[np.int64]],
    segment: NDArray[np.int64],
    budget: int,
) -> Generator[None, None, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Return levels of landmarks (m,) and segments (s,), breadth-first from one landmark.

    Neighbours are at most one level apart.  A pause follows each `budget` of rows looked at.

    Parameters
    ----------
    start : int
    begin : (s + 1,) int64
        Where the rows of each segment begin.
    landmark, segment : (n,) int64
        Of each row.
    by_landmark : (m + 1,) int64 and (n,) int64
        See `rows_of_each`.
    budget : int
    """
    from relmap.core.refinement.joint_kernels import breadth_first

    m = len(by_landmark[0]) - 1
    found = np.full(m, -1), np.full(len(begin) - 1, -1)
    queue, state = np.empty(m, dtype=np.int64), np.array([0, 0, 0, start])
    graph = begin, landmark, *by_landmark, segment
    while not breadth_first(*graph, *found, queue, state, budget):
        yield
    # Where one component ends, its last landmarks may stand a level beyond its last segments.
    return found[0], numbered(found[1])[1]


def at_once(steps: Generator[None, None, Result]) -> Result:
    """Run through all steps of a computation; return its result."""
    while True:
        try:
            next(steps)
        except StopIteration as done:
            found: Result = done.value
            return found


def numbered(values: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return what is among values (k,), ascending, and the place of each in that."""
    there = np.zeros(int(values.max(initial=-1)) + 1, dtype=bool)
    there[values] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1)[values]
