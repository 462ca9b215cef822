"""Frame-to-frame: the motion from one scan to the next, chained."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.methods.base import Method, MethodInfo, Poses, identified
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.core.landmarks import LandmarkMap, in_space


class FrameToFrame(Method):
    """Fits each scan to the one before by least squares and chains what comes out.

    A landmark is the mean of its observations, each placed with the chained pose of its scan.  A
    scan that shares too little with the last one placed is left out.

    Parameters
    ----------
    dimension : int
        2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        self._R, self._t = np.eye(dimension), np.zeros(dimension)
        self._last: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None
        self._sums: dict[int, NDArray[np.float64]] = {}
        self._counts: dict[int, int] = {}
        self._poses = Poses()
        self._dimension = dimension

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Take in one scan; see `Method.update`."""
        labels, known = identified(ids, len(points_robot))
        seen, points = labels[known], points_robot[known]
        if not len(seen) or not self._step(seen, points):
            self._poses.append_none()
            return labels
        self._last = seen, points
        self._poses.append(self._R, self._t)
        for label, place in zip(seen.tolist(), points @ self._R.T + self._t, strict=True):
            self._sums[label] = self._sums.get(label, 0.0) + place
            self._counts[label] = self._counts.get(label, 0) + 1
        return labels

    def _step(self, seen: NDArray[np.int64], points: NDArray[np.float64]) -> bool:
        """Move the pose on to a scan; tell whether the last one fixes it."""
        if self._last is None:
            return True
        _, here, before = np.intersect1d(seen, self._last[0], return_indices=True)
        there = self._last[1][before]
        if not len(there) or not fixes_rotation(there):
            return False
        R, t = fit_rigid(points[here], there)
        self._R, self._t = self._R @ R, self._R @ t + self._t
        return True

    @property
    def map(self) -> LandmarkMap:
        """The landmarks placed so far."""
        labels = np.array(sorted(self._sums), np.int64)
        means = [self._sums[label] / self._counts[label] for label in labels.tolist()]
        return LandmarkMap(labels, in_space(np.array(means).reshape(-1, self._dimension)))

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The chained pose of every scan."""
        return self._poses.values


METHOD = MethodInfo(
    "frame-to-frame",
    "fits every scan to the one before and chains the steps",
    lambda setup: FrameToFrame(setup.dimension),
    needs_ids=True,
)
