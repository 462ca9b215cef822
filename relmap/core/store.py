"""Every landmark's past observations, untransformed (Fig. 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.growing import GrowingArray


class ObservationStore:
    """Observations of all landmarks in the robot frame, as they were seen.

    The paper keeps a table of iterations per landmark.  Here one structure of arrays holds them
    in the order in which they came, which serves every landmark at once: a block of members by
    iterations is gathered in time proportional to what was seen in those iterations, whatever the
    size of the map.
    """

    def __init__(self) -> None:
        self._points: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._landmarks: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._offsets: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._offsets.extend(np.zeros(1, dtype=np.int64))
        self._slots: GrowingArray[np.int64] = GrowingArray(np.int64)

    @property
    def dimension(self) -> int:
        """2 in a planar world, 3 in space, 0 before anything was seen."""
        return int(self.points_robot.shape[1])

    @property
    def n_iterations(self) -> int:
        """Number of iterations stored, empty ones included."""
        return len(self._offsets) - 1

    @property
    def points_robot(self) -> NDArray[np.float64]:
        """All observations (n, d), robot frame, metres, in order of iteration."""
        return self._points.values

    @property
    def landmarks(self) -> NDArray[np.int64]:
        """Landmark of each observation (n,)."""
        return self._landmarks.values

    @property
    def offsets(self) -> NDArray[np.int64]:
        """Iteration i holds the observations ``offsets[i]:offsets[i + 1]``; (n_iterations + 1,)."""
        return self._offsets.values

    def append(self, landmarks: NDArray[np.int64], points_robot: NDArray[np.float64]) -> None:
        """Store one iteration's observations: landmarks (n,), points (n, d)."""
        if self.dimension == 0 and len(landmarks):
            self._points = GrowingArray(np.float64, points_robot.shape[1:])
        if len(landmarks):
            self._points.extend(points_robot)
        self._landmarks.extend(landmarks)
        self._offsets.extend(np.array([len(self._landmarks)]))
        if len(landmarks):
            self._slots.resize(int(landmarks.max()) + 1, -1)

    def relabel(self, old: int, new: int, begin: int) -> None:
        """Give the observations of a landmark, which begin in iteration `begin`, to another."""
        rows = self.landmarks[self.offsets[begin] :]
        rows[rows == old] = new

    def seen(self, begin: int, end: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return landmark and iteration of every observation in iterations `begin` to `end`."""
        offsets = self.offsets[begin : end + 1]
        iterations = np.repeat(np.arange(begin, end), np.diff(offsets))
        return self.landmarks[offsets[0] : offsets[-1]], iterations

    def gather(
        self, members: NDArray[np.int64], iterations: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return the block of the members' observations in the given iterations.

        Parameters
        ----------
        members : (g,) int64
            Landmarks, each once.
        iterations : (i,) int64, ascending

        Returns
        -------
        (g, i, d) float64, robot frame, metres
            NaN where a member was not seen.
        """
        block = np.full((len(members), len(iterations), self.dimension), np.nan)
        if block.size == 0:
            return block
        begin = iterations[0]
        landmarks, seen_at = self.seen(begin, iterations[-1] + 1)
        column_of = np.full(iterations[-1] + 1 - begin, -1)
        column_of[iterations - begin] = np.arange(len(iterations))
        slots = self._slots.values
        slots[members] = np.arange(len(members))
        row, column = slots[landmarks], column_of[seen_at - begin]
        slots[members] = -1
        wanted = (row >= 0) & (column >= 0)
        first = self.offsets[begin]
        block[row[wanted], column[wanted]] = self.points_robot[first : first + len(row)][wanted]
        return block
