"""Methods that solve for everything at the end: the log, collected scan by scan."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.methods.base import NO_MAP, Method, identified
from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.landmarks import LandmarkMap
from relmap.datasets.base import ObservationLog


class SolvedAtTheEnd(Method):
    """Keeps all scans, and maps them when the log is over.

    Parameters
    ----------
    dimension : int
        2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        self._points: list[NDArray[np.float64]] = [np.empty((0, dimension))]
        self._ids: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
        self._map = NO_MAP

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Keep one scan; see `Method.update`."""
        labels, _ = identified(ids, len(points_robot))
        self._points.append(points_robot)
        self._ids.append(labels)
        return labels

    def finish(self) -> None:
        """Solve."""
        self._map = self._solved(self._log)

    @abstractmethod
    def _solved(self, log: ObservationLog) -> LandmarkMap:
        """Return the map of all scans."""

    @property
    def _log(self) -> ObservationLog:
        """All scans, iterations counted from 0; ids are -1 where there is none."""
        counts = [len(ids) for ids in self._ids[1:]]
        iteration, rows = np.repeat(np.arange(len(counts)), counts), np.arange(sum(counts))
        points, ids = np.concatenate(self._points), np.concatenate(self._ids)
        return ObservationLog(points, iteration, rows, 0, len(counts), ids)

    @property
    def map(self) -> LandmarkMap:
        """The landmarks; none before the end."""
        return self._map

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The poses that belong to the map: each scan fits it best."""
        return fitted_poses(self._log, self._map)


def fitted_poses(log: ObservationLog, found: LandmarkMap) -> NDArray[np.float64]:
    """Return the pose (k, 4, 4) with which each scan fits the map best; NaN where none is fixed."""
    assert log.ids is not None
    k, d = len(log), log.points_robot.shape[1]
    poses = np.full((k, 4, 4), np.nan)
    mapped = np.isin(log.ids, found.landmark_ids)
    if not mapped.any():
        return poses
    there = found.positions[np.searchsorted(found.landmark_ids, log.ids[mapped]), :d]
    at = log.iteration[mapped] - log.first_iteration
    R, t, fixed = fit_rigid_each(log.points_robot[mapped], there, np.ones(len(at)), at, k)
    poses[fixed] = np.eye(4)
    poses[fixed, :d, :d], poses[fixed, :d, 3] = R[fixed], t[fixed]
    return poses
