"""Maps from relative locations: SLAM with no probability, scan matching or odometry."""

from __future__ import annotations

from relmap.core.config import MapperConfig
from relmap.core.errors import RelmapError
from relmap.core.odometry import motion_from_velocity
from relmap.core.sensor import range_bearing_covariances
from relmap.planes import PlaneMapper
from relmap.points import PointMapper
from relmap.segmentation import PlaneSegmenter

__version__ = "0.1.0"

__all__ = [
    "MapperConfig",
    "PlaneMapper",
    "PlaneSegmenter",
    "PointMapper",
    "RelmapError",
    "__version__",
    "motion_from_velocity",
    "range_bearing_covariances",
]
