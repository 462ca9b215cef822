"""Known landmarks mapped scan by scan: each fitted to the previous one, or to the map so far."""

from __future__ import annotations

import numpy as np

from relmap.comparison.baselines.base import KnownBaseline, Pose, fitted, map_of
from relmap.core.arrays import Floats, Ints
from relmap.core.association import KnownAssociation
from relmap.core.landmarks import LandmarkMap, in_space
from relmap.core.state.growing import GrowingArray
from relmap.datasets.base import ObservationLog


class FrameToMap(KnownBaseline):
    """Fits every scan to the map by least squares, then averages the scan into the map.

    Each landmark is the mean of all its observations so far, each transformed by the pose of its
    scan; all mapped landmarks in a scan have equal weight in the fit. A scan whose mapped landmarks
    determine no pose is left out, as are observations that `KnownAssociation` rejects.
    """

    def __init__(self, dimension: int = 3) -> None:
        super().__init__(dimension)
        self._association = KnownAssociation()
        self._means: GrowingArray[np.float64] = GrowingArray(np.float64, (dimension,))
        self._counts: GrowingArray[np.int64] = GrowingArray(np.int64)

    def _placed(self, points: Floats, labels: Ints) -> Pose | None:
        landmarks = self._association.match(points, labels)
        accepted = landmarks >= 0
        landmarks, points = landmarks[accepted], points[accepted]
        self._means.resize(int(landmarks.max(initial=-1)) + 1, np.nan)
        self._counts.resize(int(landmarks.max(initial=-1)) + 1, 0)
        pose = self._fitted(landmarks, points)
        if pose is not None:
            placed = points @ pose[0].T + pose[1]
            counts, means = self._counts.values, self._means.values
            counts[landmarks] += 1
            before = np.where(counts[landmarks, None] > 1, means[landmarks], placed)
            means[landmarks] = before + (placed - before) / counts[landmarks, None]
        return pose

    def _fitted(self, landmarks: Ints, points: Floats) -> Pose | None:
        """Return the pose of a scan, or None if the map does not determine it."""
        if len(points) and not self._counts.values.any():
            return np.eye(self._d), np.zeros(self._d)
        known = self._counts.values[landmarks] > 0
        return fitted(points[known], self._means.values[landmarks[known]])

    @property
    def map(self) -> LandmarkMap:
        """The landmarks mapped so far, in ascending order of ids."""
        labels = self._association.labels_of(np.arange(len(self._counts)))
        order = np.argsort(labels)
        order = order[self._counts.values[order] > 0]
        return LandmarkMap(labels[order], in_space(self._means.values[order]))


def frame_to_map(log: ObservationLog) -> FrameToMap:
    """Map a log with ids by frame-to-map averaging."""
    baseline = FrameToMap(log.points_robot.shape[1])
    for scan in log.scans():
        baseline.update(scan.points_robot, scan.ids)
    return baseline


class FrameToFrame(KnownBaseline):
    """Fits each scan to the previous one by least squares and chains the motions.

    A landmark is the mean of its observations, each transformed by the chained pose of its scan. A
    scan that shares too little with the last placed one is left out.
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
