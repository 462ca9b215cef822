"""Frame-to-map averaging: the plain way to map landmarks whose ids are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.methods.base import Method, MethodInfo, Poses, identified
from relmap.core.association import KnownAssociation
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.core.landmarks import LandmarkMap, in_space
from relmap.core.state.growing import GrowingArray


class FrameToMap(Method):
    """Fits every scan to the map by least squares, then averages the scan into the map.

    Each landmark is the mean of all its observations so far, each brought into the map with the
    pose of its scan; every mapped landmark in a scan counts alike in the fit.  A scan whose mapped
    landmarks fix no pose is left out.
    """

    def __init__(self) -> None:
        self._registration = KnownAssociation()
        self._means: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._counts: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._poses = Poses()

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Take in one scan: points (n, 2) or (n, 3), robot frame, metres; ids (n,)."""
        labels, seen = identified(ids, len(points_robot))
        landmarks, points = self._registration.match(points_robot, labels)[seen], points_robot[seen]
        if len(landmarks) and not len(self._means):
            self._means = GrowingArray(np.float64, points.shape[1:])
        self._means.resize(int(landmarks.max(initial=-1)) + 1, np.nan)
        self._counts.resize(int(landmarks.max(initial=-1)) + 1, 0)
        pose = self._pose(landmarks, points)
        if pose is None:
            self._poses.append_none()
            return labels
        R, t = pose
        self._poses.append(R, t)
        self._average_in(landmarks, points @ R.T + t)
        return labels

    def _pose(
        self, landmarks: NDArray[np.int64], points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return ``T_map_robot`` as R and t, or None where the map fixes no pose."""
        if not len(points):
            return None
        if not self._counts.values.any():
            return np.eye(points.shape[1]), np.zeros(points.shape[1])
        known = self._counts.values[landmarks] > 0
        there = self._means.values[landmarks[known]]
        if not known.any() or not fixes_rotation(there):
            return None
        return fit_rigid(points[known], there)

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

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The pose that each scan was fitted with."""
        return self._poses.values


METHOD = MethodInfo(
    "frame-to-map",
    "fits every scan to the map, then averages it in",
    lambda setup: FrameToMap(),
    needs_ids=True,
)
