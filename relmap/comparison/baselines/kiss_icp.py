"""KISS-ICP on the points of each scan: a path, and no map of landmarks.

Vizzo et al., "KISS-ICP: In defense of point-to-point ICP", RA-L 2023; needs ``relmap[peers]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.comparison.baselines.base import Baseline
from relmap.core.landmarks import in_space

BEYOND = 1.25
"""Its range, in units of the farthest observation; its voxel is a hundredth of that."""


class KissIcp(Baseline):
    """Registers each scan to a voxel map of those before; no deskewing: a scan is one instant.

    Parameters
    ----------
    range_m : float
        Distance of the farthest observation, metres.
    """

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

    def update(
        self, points_robot: NDArray[np.float64], /, ids: NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Register one scan; ids are not used."""
        self._pipeline.register_frame(in_space(points_robot), np.empty(0))
        none = np.full(len(points_robot), -1, np.int64)
        return self._keep(none, self._pipeline.last_pose.copy())
