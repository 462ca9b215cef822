"""gtsam's batch solver (Levenberg-Marquardt) over all observations, at the end.

Dellaert and Kaess, "Factor graphs for robot perception", 2017; needs the extra ``relmap[peers]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.baselines.factors import Factors
from relmap.comparison.baselines.frame_to_map import FrameToMap
from relmap.comparison.methods.base import NO_MAP, MethodInfo
from relmap.comparison.methods.collected import SolvedAtTheEnd
from relmap.core.landmarks import LandmarkMap, in_space
from relmap.datasets.base import ObservationLog


class GtsamBatch(SolvedAtTheEnd):
    """Solves when the log is over, from where frame-to-map averaging ends.

    Parameters
    ----------
    dimension : int
    sigma_m : float
        Standard deviation of each observed coordinate, metres.
    """

    def __init__(self, dimension: int, sigma_m: float) -> None:
        import gtsam

        super().__init__(dimension)
        self._gtsam: Any = gtsam
        self._d, self._factors = dimension, Factors(dimension, sigma_m)
        self._start = FrameToMap()

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Keep one scan, and average it into a map to start from; see `Method.update`."""
        self._start.update(points_robot, ids)
        return super().update(points_robot, ids)

    def _solved(self, log: ObservationLog) -> LandmarkMap:
        start = self._start
        labels = start.map.landmark_ids
        if not len(labels):
            return NO_MAP
        graph, values = self._gtsam.NonlinearFactorGraph(), self._gtsam.Values()
        for label, place in zip(labels.tolist(), start.map.positions[:, : self._d], strict=True):
            values.insert(self._factors.landmark_key(label), place)
        self._add_scans(graph, values, log, labels)
        found = self._gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        places = np.array([self._factors.landmark(found, label) for label in labels.tolist()])
        return LandmarkMap(labels, in_space(places))

    def _add_scans(
        self, graph: Any, values: Any, log: ObservationLog, labels: NDArray[np.int64]
    ) -> None:
        """Add the scans that frame-to-map averaging could place."""
        d, first = self._d, True
        for k, (scan, T) in enumerate(zip(log.scans(), self._start.trajectory, strict=True)):
            if not np.isfinite(T).all():
                continue
            assert scan.ids is not None
            pose = self._factors.pose(T[:d, :d], T[:d, 3])
            values.insert(self._factors.pose_key(k), pose)
            if first:
                graph.add(self._factors.prior(k, pose))
                first = False
            mapped = np.isin(scan.ids, labels)
            seen, points = scan.ids[mapped].tolist(), scan.points_robot[mapped]
            for factor in self._factors.of_scan(k, points, seen):
                graph.add(factor)


METHOD = MethodInfo(
    "gtsam-batch",
    "gtsam's Levenberg-Marquardt over all observations at the end",
    lambda setup: GtsamBatch(setup.dimension, setup.sigma_m),
    needs_ids=True,
    needs="gtsam",
)
