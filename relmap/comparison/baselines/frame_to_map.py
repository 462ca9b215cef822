"""Frame-to-map averaging: the simplest way to map landmarks with known ids."""

from __future__ import annotations

import numpy as np

from relmap.comparison.baselines.base import KnownBaseline, Pose, fitted
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

    `dimension`: 2 or 3.
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
            self._average_in(landmarks, points @ pose[0].T + pose[1])
        return pose

    def _fitted(self, landmarks: Ints, points: Floats) -> Pose | None:
        """Return the pose of a scan, or None if the map does not determine it."""
        if len(points) and not self._counts.values.any():
            return np.eye(self._d), np.zeros(self._d)
        known = self._counts.values[landmarks] > 0
        return fitted(points[known], self._means.values[landmarks[known]])

    def _average_in(self, landmarks: Ints, placed: Floats) -> None:
        counts, means = self._counts.values, self._means.values
        counts[landmarks] += 1
        before = np.where(counts[landmarks, None] > 1, means[landmarks], placed)
        means[landmarks] = before + (placed - before) / counts[landmarks, None]

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
