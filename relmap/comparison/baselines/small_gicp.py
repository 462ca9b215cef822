"""small_gicp, each scan to the one before: a path, and no map of landmarks.

Koide, "small_gicp: Efficient and parallel algorithms for point cloud registration", JOSS 2024;
needs the extra ``relmap[peers]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.baselines.base import Baseline
from relmap.core.landmarks import in_space

REACH = 1 / 32
"""Largest distance of matched points, as a share of the farthest observation."""
FINE = 1 / 200
"""Voxel that a scan is thinned by, likewise."""
FEWEST = 11
"""Points without which small_gicp does nothing: then the motion is taken to go on."""
ENOUGH = 200
"""Points of a scan from which on it is GICP: a covariance takes ten neighbours; else plain ICP."""


class SmallGicp(Baseline):
    """Chains registrations, each begun at the motion of the one before (constant velocity).

    Parameters
    ----------
    range_m : float
        Distance of the farthest observation, metres.
    """

    def __init__(self, range_m: float) -> None:
        super().__init__()
        import small_gicp

        self._small_gicp: Any = small_gicp
        self._range_m = range_m
        self._last = np.empty((0, 3))
        self._motion, self._pose = np.eye(4), np.eye(4)

    def update(
        self, points_robot: NDArray[np.float64], /, ids: NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Register one scan; ids are not used."""
        points = in_space(points_robot)
        if min(len(points), len(self._last)) >= FEWEST:
            self._motion = self._registered(points).T_target_source
        self._pose = self._pose @ self._motion
        self._last = points
        return self._keep(np.full(len(points), -1, np.int64), self._pose)

    def _registered(self, points: NDArray[np.float64]) -> Any:
        """Register points (n, 3) to those of the last scan."""
        align, reach = self._small_gicp.align, REACH * self._range_m
        if min(len(points), len(self._last)) < ENOUGH:
            cloud = self._small_gicp.PointCloud
            target, source = cloud(self._last), cloud(points)
            tree = self._small_gicp.KdTree(target)
            return align(target, source, tree, self._motion, "ICP", reach)
        fine = FINE * self._range_m
        return align(self._last, points, self._motion, "GICP", 1.0, fine, reach)
