"""Every landmark's past observations, untransformed (Fig. 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.state.growing import FEW, GrowingArray


class ObservationStore:
    """Observations of all landmarks in the robot frame, as they were seen.

    The paper keeps a table of iterations per landmark.  Here one structure of arrays holds them
    in the order in which they came, which serves every landmark at once: a block of members by
    iterations is gathered in time proportional to what was seen in those iterations, whatever the
    size of the map.
    """

    STATE = "_points _landmarks _offsets _slots _first_iteration"

    def __init__(self) -> None:
        self._points: GrowingArray[np.float64] = GrowingArray(np.float64, (0,), FEW)
        self._landmarks: GrowingArray[np.int64] = GrowingArray(np.int64, room=FEW)
        self._offsets: GrowingArray[np.int64] = GrowingArray(np.int64, room=FEW)
        self._offsets.extend(np.zeros(1, dtype=np.int64))
        self._slots: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._first_iteration = 0

    @property
    def dimension(self) -> int:
        """2 in a planar world, 3 in space, 0 before anything was seen."""
        return int(self.points_robot.shape[1])

    @property
    def n_iterations(self) -> int:
        """Number of iterations seen, empty and forgotten ones included."""
        return self._first_iteration + len(self._offsets) - 1

    @property
    def first_iteration(self) -> int:
        """The first iteration that is not forgotten."""
        return self._first_iteration

    @property
    def points_robot(self) -> NDArray[np.float64]:
        """Observations kept (n, d), robot frame, metres, in order of iteration."""
        return self._points.values

    @property
    def landmarks(self) -> NDArray[np.int64]:
        """Landmark of each observation (n,)."""
        return self._landmarks.values

    def append(self, landmarks: NDArray[np.int64], points_robot: NDArray[np.float64]) -> None:
        """Store one iteration's observations: landmarks (n,), points (n, d)."""
        if self.dimension == 0 and len(landmarks):
            self._points = GrowingArray(np.float64, points_robot.shape[1:], FEW)
        if len(landmarks):
            self._points.extend(points_robot)
        self._landmarks.extend(landmarks)
        self._offsets.extend(self._offsets.values[-1:] + len(landmarks))
        if len(landmarks):
            self._slots.resize(int(landmarks.max()) + 1, -1)

    def forget(self, before: int) -> None:
        """Drop the iterations before one that no later step needs."""
        n = before - self._first_iteration
        if n > 0:
            rows = int(self._offsets.values[n] - self._offsets.values[0])
            self._points.drop(rows)
            self._landmarks.drop(rows)
            self._offsets.drop(n)
            self._first_iteration = before

    def relabel(self, old: int, new: int) -> None:
        """Give the observations kept of a landmark to another."""
        self.landmarks[self.landmarks == old] = new

    def seen(self, begin: int, end: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return landmark and iteration of every observation in iterations `begin` to `end`."""
        rows, sizes = self._rows(begin, end)
        return self.landmarks[rows], np.repeat(np.arange(begin, end), sizes)

    def points(self, begin: int, end: int) -> NDArray[np.float64]:
        """Return every observation (k, d) in iterations `begin` to `end`, ordered as in `seen`."""
        return self.points_robot[self._rows(begin, end)[0]]

    def _rows(self, begin: int, end: int) -> tuple[slice, NDArray[np.int64]]:
        """Return the rows of some iterations, and how many each has."""
        first = begin - self._first_iteration
        offsets = self._offsets.values[first : end - self._first_iteration + 1]
        base = self._offsets.values[0]
        return slice(int(offsets[0] - base), int(offsets[-1] - base)), np.diff(offsets)

    def seen_with(
        self, seed: int, begin: int, end: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Return everything seen in those of the iterations `begin` to `end` that show a seed.

        Returns
        -------
        landmarks : (n,) int64
            The seed, then the others as they were first seen.
        iterations : (i,) int64, ascending
        block : (n, i, d) float64, robot frame, metres
            NaN where a landmark was not seen.
        """
        from relmap.core.grouping.chart_kernels import chart_block

        first = begin - self._first_iteration
        offsets = self._offsets.values[first : end - self._first_iteration + 1]
        rows, _ = self._rows(begin, end)
        landmarks, columns, block = chart_block(
            self.landmarks[rows],
            self.points_robot[rows],
            offsets - offsets[0],
            seed,
            self._slots.values,
        )
        order = np.argsort(np.where(landmarks == seed, -1, landmarks))
        return landmarks[order], columns + begin, block[order]
