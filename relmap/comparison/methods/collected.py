"""For methods that solve for everything at the end: the log, scan by scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.methods.base import identified
from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.landmarks import LandmarkMap
from relmap.datasets.base import ObservationLog


class CollectedLog:
    """Scans that were handed to a method.

    Parameters
    ----------
    dimension : int
        2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        self._points: list[NDArray[np.float64]] = [np.empty((0, dimension))]
        self._ids: list[NDArray[np.int64]] = [np.empty(0, np.int64)]

    def append(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Keep one scan; return the ids, -1 where there is none."""
        labels, _ = identified(ids, len(points_robot))
        self._points.append(points_robot)
        self._ids.append(labels)
        return labels

    @property
    def log(self) -> ObservationLog:
        """All of it, iterations counted from 0."""
        counts = [len(ids) for ids in self._ids[1:]]
        n = sum(counts)
        return ObservationLog(
            points_robot=np.concatenate(self._points),
            iteration=np.repeat(np.arange(len(counts)), counts),
            rows=np.arange(n),
            first_iteration=0,
            end_iteration=len(counts),
            ids=np.concatenate(self._ids),
        )


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
