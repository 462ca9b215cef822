"""Frame-to-frame: the motion from one scan to the next, chained."""

from __future__ import annotations

import numpy as np

from relmap.comparison.baselines.base import KnownBaseline, Pose, fitted, map_of
from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import LandmarkMap


class FrameToFrame(KnownBaseline):
    """Fits each scan to the previous one by least squares and chains the motions.

    A landmark is the mean of its observations, each transformed by the chained pose of its scan. A
    scan that shares too little with the last placed one is left out.

    `dimension`: 2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        super().__init__(dimension)
        self._pose: Pose = np.eye(dimension), np.zeros(dimension)
        self._last: tuple[Ints, Floats] | None = None
        self._sums: dict[int, Floats] = {}
        self._counts: dict[int, int] = {}

    def _placed(self, points: Floats, labels: Ints) -> Pose | None:
        if not len(labels) or not self._step(points, labels):
            return None
        self._last = labels, points
        R, t = self._pose
        for label, place in zip(labels.tolist(), points @ R.T + t, strict=True):
            self._sums[label] = self._sums.get(label, 0.0) + place
            self._counts[label] = self._counts.get(label, 0) + 1
        return R, t

    def _step(self, points: Floats, labels: Ints) -> bool:
        """Advance the pose to a scan; return whether the last one determines it."""
        if self._last is None:
            return True
        _, here, before = np.intersect1d(labels, self._last[0], return_indices=True)
        step = fitted(points[here], self._last[1][before])
        if step is None:
            return False
        R, t = self._pose
        self._pose = R @ step[0], R @ step[1] + t
        return True

    @property
    def map(self) -> LandmarkMap:
        """The landmarks placed so far."""
        return map_of({label: place / self._counts[label] for label, place in self._sums.items()})
