"""Frame-to-map averaging: the plain way to map landmarks whose ids are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid, fixes_rotation
from relmap.core.growing import GrowingArray
from relmap.core.landmarks import LandmarkMap, in_space
from relmap.core.registration import KnownAssociation


class FrameToMap:
    """Fits every scan to the map by least squares, then averages the scan into the map.

    Each landmark is the mean of all its observations so far, each brought into the map with the
    pose of its scan; every mapped landmark in a scan counts alike in the fit.  A scan whose mapped
    landmarks fix no pose is left out.
    """

    def __init__(self) -> None:
        self._registration = KnownAssociation()
        self._means: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._counts: GrowingArray[np.int64] = GrowingArray(np.int64)

    def update(self, points_robot: NDArray[np.float64], ids: NDArray[np.int64]) -> None:
        """Take in one scan: points (n, 2) or (n, 3), robot frame, metres; ids (n,)."""
        landmarks = self._registration.match(points_robot, ids)
        landmarks, points = landmarks[landmarks >= 0], points_robot[landmarks >= 0]
        if not len(landmarks):
            return
        if not len(self._means):
            self._means = GrowingArray(np.float64, points.shape[1:])
        self._means.resize(int(landmarks.max()) + 1, np.nan)
        self._counts.resize(int(landmarks.max()) + 1, 0)
        placed = self._placed(landmarks, points)
        if placed is not None:
            self._average_in(landmarks, placed)

    def _placed(
        self, landmarks: NDArray[np.int64], points: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return the points in the map frame, or None where the map fixes no pose."""
        if not self._counts.values.any():
            return points
        known = self._counts.values[landmarks] > 0
        there = self._means.values[landmarks[known]]
        if not known.any() or not fixes_rotation(there):
            return None
        R, t = fit_rigid(points[known], there)
        return points @ R.T + t

    def _average_in(self, landmarks: NDArray[np.int64], placed: NDArray[np.float64]) -> None:
        counts, means = self._counts.values, self._means.values
        counts[landmarks] += 1
        before = np.where(counts[landmarks, None] > 1, means[landmarks], placed)
        means[landmarks] = before + (placed - before) / counts[landmarks, None]

    @property
    def map(self) -> LandmarkMap:
        """The landmarks mapped so far, in ascending order of their ids."""
        labels = self._registration.labels_of(np.arange(len(self._counts)))
        mapped = self._counts.values > 0
        order = np.argsort(labels)[mapped[np.argsort(labels)]]
        return LandmarkMap(labels[order], in_space(self._means.values[order]))
