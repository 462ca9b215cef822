"""Methods that solve once at the end; the log is collected scan by scan."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from relmap.comparison.baselines.base import NO_MAP, KnownBaseline, Pose
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.landmarks import LandmarkMap
from relmap.datasets.base import ObservationLog


class SolvedAtTheEnd(KnownBaseline):
    """Collects all scans, and maps them at the end of the log.

    `dimension`: 2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        super().__init__(dimension)
        self._points = [np.empty((0, dimension))]
        self._map = NO_MAP

    def _placed(self, points: Floats, labels: Ints) -> Pose | None:
        self._points.append(points)
        return None

    def finish(self) -> None:
        """Solve."""
        self._map = self._solved(self._log)

    @abstractmethod
    def _solved(self, log: ObservationLog) -> LandmarkMap:
        """Return the map of all scans."""

    @property
    def _log(self) -> ObservationLog:
        """All identified observations, iterations counted from 0."""
        counts = [len(points) for points in self._points[1:]]
        iteration, rows = np.repeat(np.arange(len(counts)), counts), np.arange(sum(counts))
        points, ids = np.concatenate(self._points), np.concatenate(self._labels)
        return ObservationLog(points, iteration, rows, 0, len(counts), ids[ids >= 0])

    @property
    def map(self) -> LandmarkMap:
        """The landmarks; none before the end."""
        return self._map

    @property
    def trajectory(self) -> Floats:
        """The poses (k, 4, 4) that fit each scan to the map; NaN if undetermined."""
        log, found = self._log, self._map
        assert log.ids is not None
        k, d = len(log), self._d
        poses = np.full((k, 4, 4), np.nan)
        mapped = np.isin(log.ids, found.landmark_ids)
        if not mapped.any():
            return poses
        there = found.positions[np.searchsorted(found.landmark_ids, log.ids[mapped]), :d]
        weights, at = np.ones(len(there)), log.iteration[mapped]
        R, t, fixed = fit_rigid_each(log.points_robot[mapped], there, weights, at, k)
        poses[fixed] = np.eye(4)
        poses[fixed, :d, :d], poses[fixed, :d, 3] = R[fixed], t[fixed]
        return poses
