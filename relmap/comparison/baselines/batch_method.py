"""Batch least squares as a method among others: it solves when the log is over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.baselines.known import least_squares_map
from relmap.comparison.methods.base import NO_MAP, Method, MethodInfo
from relmap.comparison.methods.collected import CollectedLog, fitted_poses
from relmap.core.landmarks import LandmarkMap


class BatchLeastSquares(Method):
    """Solves for all poses and landmarks at once, at the end: the limit that a map can reach.

    Parameters
    ----------
    dimension : int
        2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        self._collected = CollectedLog(dimension)
        self._map = NO_MAP

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Keep one scan; see `Method.update`."""
        return self._collected.append(points_robot, ids)

    def finish(self) -> None:
        """Solve."""
        self._map = least_squares_map(self._collected.log)

    @property
    def map(self) -> LandmarkMap:
        """The landmarks; none before the end."""
        return self._map

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The poses that belong to the map: each scan fits it best."""
        return fitted_poses(self._collected.log, self._map)


METHOD = MethodInfo(
    "batch",
    "sparse least squares over all observations at the end: the limit",
    lambda setup: BatchLeastSquares(setup.dimension),
    needs_ids=True,
)
