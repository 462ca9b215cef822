"""gtsam's batch solver (Levenberg-Marquardt) over all observations, at the end.

Dellaert and Kaess, "Factor graphs for robot perception", 2017; needs the extra ``relmap[peers]``.
"""

from __future__ import annotations

import numpy as np

from relmap.comparison.baselines.base import map_of
from relmap.comparison.baselines.factors import Factors
from relmap.comparison.baselines.frame_to_map import FrameToMap, frame_to_map
from relmap.comparison.baselines.solved import SolvedAtTheEnd
from relmap.core.landmarks import LandmarkMap
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
        super().__init__(dimension)
        self._factors = Factors(dimension, sigma_m)

    def _solved(self, log: ObservationLog) -> LandmarkMap:
        start, factors = frame_to_map(log), self._factors
        labels = start.map.landmark_ids.tolist()
        if not labels:
            return start.map
        for label, place in zip(labels, start.map.positions[:, : self._d], strict=True):
            factors.add_landmark(label, place)
        self._add_scans(log, start)
        found = factors.gtsam.LevenbergMarquardtOptimizer(factors.graph, factors.values).optimize()
        return map_of({label: factors.landmark(found, label) for label in labels})

    def _add_scans(self, log: ObservationLog, start: FrameToMap) -> None:
        """Add the scans that frame-to-map averaging could place."""
        d, labels = self._d, start.map.landmark_ids
        for k, (scan, T) in enumerate(zip(log.scans(), start.trajectory, strict=True)):
            if np.isfinite(T).all() and scan.ids is not None:
                mapped = np.isin(scan.ids, labels)
                seen, points = scan.ids[mapped].tolist(), scan.points_robot[mapped]
                self._factors.add_scan(k, (T[:d, :d], T[:d, 3]), points, seen)
