"""iSAM2 of gtsam: incremental smoothing over all poses and landmarks.

Kaess et al., "iSAM2: Incremental smoothing and mapping using the Bayes tree", IJRR 2012; needs the
extra ``relmap[peers]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.baselines.factors import Factors
from relmap.comparison.methods.base import NO_POSE, Method, MethodInfo, identified
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.core.landmarks import LandmarkMap, in_space

RELINEARIZE = 0.01
"""Change of a variable, metres or radians, that relinearises it: as in gtsam's own examples."""


class Isam2(Method):
    """Smooths after every scan; a new pose begins where its scan fits the map best.

    Parameters
    ----------
    dimension : int
    sigma_m : float
        Standard deviation of each observed coordinate, metres.
    """

    def __init__(self, dimension: int, sigma_m: float) -> None:
        import gtsam

        self._gtsam: Any = gtsam
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(RELINEARIZE)
        parameters.relinearizeSkip = 1
        self._solver: Any = gtsam.ISAM2(parameters)
        self._factors = Factors(dimension, sigma_m)
        self._d = dimension
        self._places: dict[int, NDArray[np.float64]] = {}
        self._placed: list[bool] = []

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Add one scan and smooth; see `Method.update`."""
        labels, known = identified(ids, len(points_robot))
        seen, points, k = labels[known].tolist(), points_robot[known], len(self._placed)
        start = self._start(seen, points)
        self._placed.append(start is not None)
        if start is None:
            return labels
        self._smooth(k, seen, points, *start)
        return labels

    def _start(
        self, seen: list[int], points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return a pose to begin with, R and t; None where the map fixes none."""
        if not self._places:
            return (np.eye(self._d), np.zeros(self._d)) if seen else None
        old = [row for row, label in enumerate(seen) if label in self._places]
        if not old:
            return None
        there = np.array([self._places[seen[row]] for row in old])
        return fit_rigid(points[old], there) if fixes_rotation(there) else None

    def _smooth(
        self,
        k: int,
        seen: list[int],
        points: NDArray[np.float64],
        R: NDArray[np.float64],
        t: NDArray[np.float64],
    ) -> None:
        """Add one scan and read off where its landmarks are now."""
        graph, values = self._gtsam.NonlinearFactorGraph(), self._gtsam.Values()
        pose = self._factors.pose(R, t)
        values.insert(self._factors.pose_key(k), pose)
        if not self._places:
            graph.add(self._factors.prior(k, pose))
        for label, place in zip(seen, points @ R.T + t, strict=True):
            if label not in self._places:
                values.insert(self._factors.landmark_key(label), place)
        for factor in self._factors.of_scan(k, points, seen):
            graph.add(factor)
        self._solver.update(graph, values)
        solver, planar = self._solver, self._d == 2
        estimate = solver.calculateEstimatePoint2 if planar else solver.calculateEstimatePoint3
        for label in seen:
            self._places[label] = estimate(self._factors.landmark_key(label))

    @property
    def map(self) -> LandmarkMap:
        """The landmarks, as smoothed by all scans so far."""
        values, labels = self._solver.calculateEstimate(), sorted(self._places)
        places = [self._factors.landmark(values, label) for label in labels]
        return LandmarkMap(
            np.array(labels, np.int64), in_space(np.array(places).reshape(-1, self._d))
        )

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The poses, as smoothed by all scans so far."""
        values = self._solver.calculateEstimate()
        poses = [
            self._factors.pose_matrix(values, k) if placed else NO_POSE
            for k, placed in enumerate(self._placed)
        ]
        return np.array(poses).reshape(-1, 4, 4)


METHOD = MethodInfo(
    "isam2",
    "gtsam's iSAM2: smooths all poses and landmarks after every scan",
    lambda setup: Isam2(setup.dimension, setup.sigma_m),
    needs_ids=True,
    needs="gtsam",
)
