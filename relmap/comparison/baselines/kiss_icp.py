"""KISS-ICP on the points of each scan: a path, and no map of landmarks.

Vizzo et al., "KISS-ICP: In defense of point-to-point ICP", RA-L 2023; needs ``relmap[peers]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.methods.base import Method, MethodInfo
from relmap.core.landmarks import in_space

BEYOND = 1.25
"""Its range, in units of the farthest observation; its voxel is a hundredth of that."""


class KissIcp(Method):
    """Registers each scan to a voxel map of those before; no deskewing: a scan is one instant.

    Parameters
    ----------
    range_m : float
        Distance of the farthest observation, metres.
    """

    def __init__(self, range_m: float) -> None:
        from kiss_icp.config import load_config
        from kiss_icp.kiss_icp import KissICP

        config: Any = load_config(None)
        config.data.max_range, config.data.deskew = BEYOND * range_m, False
        config.data.min_range = 0.0
        config.mapping.voxel_size = config.data.max_range / 100
        config.registration.max_num_threads = 1
        self._pipeline: Any = KissICP(config)
        self._poses: list[NDArray[np.float64]] = []

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Register one scan; ids are not used."""
        self._pipeline.register_frame(in_space(points_robot), np.empty(0))
        self._poses.append(self._pipeline.last_pose.copy())
        return np.full(len(points_robot), -1, np.int64)

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """The pose of every scan, as it was estimated then."""
        return np.array(self._poses).reshape(-1, 4, 4)


METHOD = MethodInfo(
    "kiss-icp",
    "KISS-ICP on the points: a path, no landmarks",
    lambda setup: KissIcp(setup.range_m),
    logs=("landmarks", "scans"),
    needs="kiss_icp",
)
