"""The corner test of Fig. 4 on a run: which of the four midpoint pairs of two walls is static."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.planes.history import PlaneHistory

SIDES = ("right", "left")
SHORTEST = 12
"""Iterations of a common interval that are worth a look."""
STEADY_M = 0.01
"""Deviations below this are as good as none."""
SKEW = np.deg2rad(30.0)
"""Walls that are nearer to parallel than this are not shown: one of their shifts says nothing."""


@dataclass(frozen=True, eq=False)
class CornerTest:
    """Two walls over an interval in which each is seen with one static end and one cut one.

    Attributes
    ----------
    planes : tuple of int
        Numbers of the two walls.
    iterations : (k,) int64
    first, second : (k, 2, 2) float64, robot frame, metres
        Right and left end of each as observed.
    sizes : tuple of float
        The size of each wall, fixed over the interval: the largest seen in it.
    offsets : (k, 2, 2, 2) float64, metres
        See `relmap.planes.corner_kernels.midpoint_pairs`.
    static : tuple of int
        The static end of each wall, as its type in each scan told: 0 right, 1 left.
    """

    COLUMNS: ClassVar = ("iteration", "first_end", "second_end", "dx", "dy", "deviation", "chosen")

    planes: tuple[int, int]
    iterations: NDArray[np.int64]
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    sizes: tuple[float, float]
    offsets: NDArray[np.float64]
    static: tuple[int, int]

    @property
    def deviation(self) -> NDArray[np.float64]:
        """Standard deviation of each pair's offset over the interval, (2, 2), metres."""
        from relmap.planes.corner_kernels import deviations

        return deviations(self.offsets)

    @property
    def chosen(self) -> tuple[int, int]:
        """The ends whose pair has the lowest deviation."""
        i, j = np.unravel_index(np.argmin(self.deviation), (2, 2))
        return int(i), int(j)

    @property
    def skew(self) -> float:
        """How far from parallel the walls are, radians."""
        along = [ends[:, 1] - ends[:, 0] for ends in (self.first, self.second)]
        cross = along[0][:, 0] * along[1][:, 1] - along[0][:, 1] * along[1][:, 0]
        sizes = np.linalg.norm(along[0], axis=1) * np.linalg.norm(along[1], axis=1)
        return float(np.arcsin(np.clip(np.median(np.abs(cross) / sizes), 0, 1)))

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield a line for each pair in each iteration, as `COLUMNS` name them; metres."""
        for i, j in np.ndindex(2, 2):
            told = float(self.deviation[i, j]), int((i, j) == self.chosen)
            for k, (dx, dy) in zip(self.iterations, self.offsets[:, i, j], strict=True):
                yield int(k), SIDES[i], SIDES[j], float(dx), float(dy), *told


def corner_tests(history: PlaneHistory) -> list[CornerTest]:
    """Return all pairs of walls that are seen for long with one static and one cut end each."""
    from relmap.planes.corner_kernels import largest, midpoint_pairs

    runs = list(_cut_runs(history))
    tests = []
    for (plane, side, rows), (other, other_side, other_rows) in combinations(runs, 2):
        if plane == other:
            continue
        _, i, j = np.intersect1d(
            history.iteration[rows], history.iteration[other_rows], return_indices=True
        )
        if len(i) < SHORTEST:
            continue
        first, second = history.ends[rows[i]], history.ends[other_rows[j]]
        sizes = largest(first), largest(second)
        offsets = midpoint_pairs(first, second, *sizes)
        iterations = history.iteration[rows[i]]
        pair = (plane, other), iterations, first, second, sizes, offsets, (side, other_side)
        tests.append(CornerTest(*pair))
    return tests


def clearest(tests: list[CornerTest]) -> CornerTest:
    """Return the pair of walls, not parallel, that shows best what the test goes by.

    It is the one whose second lowest deviation is the largest multiple of the lowest.

    Raises
    ------
    RelmapError
        Where there is none.
    """
    possible = [test for test in tests if test.skew > SKEW]
    if not possible:
        raise RelmapError(
            f"no two walls are seen with one cut end each for {SHORTEST} scans: map a longer run"
        )
    return max(possible, key=_clearness)


def _clearness(test: CornerTest) -> float:
    lowest, second = np.sort(test.deviation, axis=None)[:2]
    return float(second / max(lowest, STEADY_M))


def _cut_runs(history: PlaneHistory) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """Yield wall, static end and rows of each run of scans that see a wall with that end alone."""
    for plane in np.unique(history.plane).tolist():
        rows = np.flatnonzero(history.plane == plane)
        static = history.corner[rows] >= 0
        side = np.where(static.sum(axis=1) == 1, static.argmax(axis=1), -1)
        breaks = (np.diff(side) != 0) | (np.diff(history.iteration[rows]) != 1)
        for run in np.split(np.arange(len(rows)), np.flatnonzero(breaks) + 1):
            if side[run[0]] >= 0 and len(run) >= SHORTEST:
                yield plane, int(side[run[0]]), rows[run]
