"""KISS-ICP and small_gicp on the points of each scan: a path, without a map of landmarks.

Vizzo et al., "KISS-ICP: In defense of point-to-point ICP", RA-L 2023; Koide, "small_gicp: Efficient
and parallel algorithms for point cloud registration", JOSS 2024; both need ``relmap[peers]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from relmap.comparison.baselines.base import Baseline
from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import in_space

BEYOND = 1.25
"""Range of KISS-ICP, in units of the farthest observation; its voxel is a hundredth of that."""
REACH = 1 / 32
"""Largest distance of points matched by small_gicp, relative to the farthest observation."""
FINE = 1 / 200
"""Voxel size for subsampling a scan, likewise."""
FEWEST = 11
"""Minimum number of points for small_gicp; with fewer, constant motion is assumed."""
ENOUGH = 200
"""Minimum number of points for GICP, whose covariances use ten neighbours; else plain ICP."""


class KissIcp(Baseline):
    """Registers each scan to a voxel map of earlier ones; no deskewing: a scan is instantaneous."""

    def __init__(self, range_m: float) -> None:
        super().__init__()
        from kiss_icp.config import load_config
        from kiss_icp.kiss_icp import KissICP

        config: Any = load_config(None)
        config.data.max_range, config.data.deskew = BEYOND * range_m, False
        config.data.min_range = 0.0
        config.mapping.voxel_size = config.data.max_range / 100
        config.registration.max_num_threads = 1
        self._pipeline: Any = KissICP(config)

    def update(self, points_robot: Floats, /, ids: Ints | None = None) -> Ints:
        """Register one scan; ids are not used."""
        self._pipeline.register_frame(in_space(points_robot), np.empty(0))
        none = np.full(len(points_robot), -1, np.int64)
        return self._keep(none, self._pipeline.last_pose.copy())


class SmallGicp(Baseline):
    """Chains registrations, each initialised with the previous motion (constant velocity)."""

    def __init__(self, range_m: float) -> None:
        super().__init__()
        import small_gicp

        self._small_gicp: Any = small_gicp
        self._range_m = range_m
        self._last = np.empty((0, 3))
        self._motion, self._pose = np.eye(4), np.eye(4)

    def update(self, points_robot: Floats, /, ids: Ints | None = None) -> Ints:
        """Register one scan; ids are not used."""
        points = in_space(points_robot)
        if min(len(points), len(self._last)) >= FEWEST:
            self._motion = self._registered(points).T_target_source
        self._pose = self._pose @ self._motion
        self._last = points
        return self._keep(np.full(len(points), -1, np.int64), self._pose)

    def _registered(self, points: Floats) -> Any:
        """Register points (n, 3) to those of the previous scan."""
        align, reach = self._small_gicp.align, REACH * self._range_m
        if min(len(points), len(self._last)) < ENOUGH:
            cloud = self._small_gicp.PointCloud
            target, source = cloud(self._last), cloud(points)
            tree = self._small_gicp.KdTree(target)
            return align(target, source, tree, self._motion, "ICP", reach)
        fine = FINE * self._range_m
        return align(self._last, points, self._motion, "GICP", 1.0, fine, reach)
