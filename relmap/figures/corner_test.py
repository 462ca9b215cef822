"""The corner test of Fig. 4 on a run: which of the four midpoint pairs of two walls is static."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from relmap.planes.history import PlaneHistory
from relmap.planes.pairwise import midpoint_pairs

SHORTEST = 12
"""Iterations of the shortest common interval that is tested."""


@dataclass(frozen=True, eq=False)
class CornerTest:
    """Two walls over an interval in which each is seen with one static end and one cut one.

    Attributes
    ----------
    planes : tuple of int
        Numbers of the two walls.
    iterations : (k,) int64
    ends : (2, k, 2, 2) float64, robot frame, metres
        Right and left end of each wall as observed.
    sizes : tuple of float
        The size of each wall, fixed over the interval: the largest seen in it.
    offsets : (k, 2, 2, 2) float64, metres
        See `relmap.planes.pairwise.midpoint_pairs`.
    static : tuple of int
        The static end of each wall by its type in each scan: 0 right, 1 left.
    """

    planes: tuple[int, int]
    iterations: NDArray[np.int64]
    ends: NDArray[np.float64]
    sizes: tuple[float, float]
    offsets: NDArray[np.float64]
    static: tuple[int, int]

    @property
    def deviation(self) -> NDArray[np.float64]:
        """Standard deviation of each pair's offset over the interval, (2, 2), metres."""
        return np.asarray(np.sqrt(self.offsets.var(axis=0).sum(axis=2)))

    @property
    def chosen(self) -> tuple[int, int]:
        """The ends whose pair has the lowest deviation."""
        i, j = np.unravel_index(np.argmin(self.deviation), (2, 2))
        return int(i), int(j)

    @property
    def skew(self) -> float:
        """How far from parallel the walls are, radians."""
        (x, y), (u, v) = np.moveaxis(self.ends[:, :, 1] - self.ends[:, :, 0], -1, 1)
        sines = np.abs(x * v - y * u) / (np.hypot(x, y) * np.hypot(u, v))
        return float(np.arcsin(np.clip(np.median(sines), 0, 1)))


def corner_tests(history: PlaneHistory) -> list[CornerTest]:
    """Return all pairs of walls that are seen for long with one static and one cut end each.

    Parameters
    ----------
    history : PlaneHistory
        All observations of a run.

    Returns
    -------
    list of CornerTest
    """
    tests = []
    for (plane, side, rows), (other, other_side, other_rows) in combinations(_cut(history), 2):
        _, i, j = np.intersect1d(
            history.iteration[rows], history.iteration[other_rows], return_indices=True
        )
        if plane == other or len(i) < SHORTEST:
            continue
        ends = np.stack([history.ends[rows[i]], history.ends[other_rows[j]]])
        first, second = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).max(axis=1).tolist()
        offsets, _ = midpoint_pairs(ends[0], ends[1], (first, second))
        pair, static = (plane, other), (side, other_side)
        iterations = history.iteration[rows[i]]
        tests.append(CornerTest(pair, iterations, ends, (first, second), offsets, static))
    return tests


def _cut(history: PlaneHistory) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """Yield wall, static end and rows of each run of scans that see a wall with that end alone."""
    for plane in np.unique(history.plane).tolist():
        rows = np.flatnonzero(history.plane == plane)
        static = history.corner[rows] >= 0
        side = np.where(static.sum(axis=1) == 1, static.argmax(axis=1), -1)
        breaks = (np.diff(side) != 0) | (np.diff(history.iteration[rows]) != 1)
        for run in np.split(np.arange(len(rows)), np.flatnonzero(breaks) + 1):
            if side[run[0]] >= 0 and len(run) >= SHORTEST:
                yield plane, int(side[run[0]]), rows[run]
