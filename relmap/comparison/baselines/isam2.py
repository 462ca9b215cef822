"""iSAM2 of gtsam: incremental smoothing over all poses and landmarks.

Kaess et al., "iSAM2: Incremental smoothing and mapping using the Bayes tree", IJRR 2012; needs the
extra ``relmap[peers]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.baselines.base import KnownBaseline, Pose, fitted, map_of
from relmap.comparison.baselines.factors import Factors
from relmap.core.landmarks import LandmarkMap

RELINEARIZE = 0.01
"""Change of a variable, metres or radians, that relinearises it: as in gtsam's own examples."""


class Isam2(KnownBaseline):
    """Smooths after every scan; a new pose begins where its scan fits the map best.

    Parameters
    ----------
    dimension : int
    sigma_m : float
        Standard deviation of each observed coordinate, metres.
    """

    def __init__(self, dimension: int, sigma_m: float) -> None:
        super().__init__(dimension)
        self._factors = Factors(dimension, sigma_m)
        parameters = self._factors.gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(RELINEARIZE)
        parameters.relinearizeSkip = 1
        self._solver: Any = self._factors.gtsam.ISAM2(parameters)
        self._places: dict[int, NDArray[np.float64]] = {}

    def _placed(self, points: NDArray[np.float64], labels: NDArray[np.int64]) -> Pose | None:
        """Add one scan and smooth; return the pose that it begins with."""
        seen, k = labels.tolist(), len(self._poses)
        start = self._start(points, seen)
        if start is None:
            return None
        factors, (R, t) = self._factors, start
        factors.add_scan(k, start, points, seen)
        for label, place in zip(seen, points @ R.T + t, strict=True):
            if label not in self._places:
                factors.add_landmark(label, place)
        self._solver.update(factors.graph, factors.values)
        factors.clear()
        solver, planar = self._solver, self._d == 2
        estimate = solver.calculateEstimatePoint2 if planar else solver.calculateEstimatePoint3
        for label in seen:
            self._places[label] = estimate(factors.landmark_key(label))
        return start

    def _start(self, points: NDArray[np.float64], seen: list[int]) -> Pose | None:
        """Return a pose to begin with; None where the map fixes none."""
        if not self._places:
            return (np.eye(self._d), np.zeros(self._d)) if seen else None
        old = [row for row, label in enumerate(seen) if label in self._places]
        there = np.array([self._places[seen[row]] for row in old]).reshape(-1, self._d)
        return fitted(points[old], there)

    @property
    def map(self) -> LandmarkMap:
        """The landmarks, as smoothed by all scans so far."""
        values = self._solver.calculateEstimate()
        return map_of({label: self._factors.landmark(values, label) for label in self._places})

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The poses, as smoothed by all scans so far."""
        values, poses = self._solver.calculateEstimate(), super().trajectory
        for k in np.flatnonzero(np.isfinite(poses[:, 0, 0])).tolist():
            poses[k] = self._factors.pose_matrix(values, k)
        return poses
