"""Maps of landmarks from their relative locations; odometry is optional.

Unless odometry is given, no motion or pose estimate enters the map: scans are registered by
matching landmarks, and probability is used in weights, in registration under large noise, and in
the optional refinement.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.core.config import MapperConfig
    from relmap.core.odometry import motion_from_velocity
    from relmap.core.sensor import range_bearing_covariances
    from relmap.planes import PlaneMapper
    from relmap.planes3d import Plane3dMapper
    from relmap.points import PointMapper
    from relmap.segmentation import PlaneSegmenter

__version__ = "0.1.0"

__all__ = [
    "MapperConfig",
    "Plane3dMapper",
    "PlaneMapper",
    "PlaneSegmenter",
    "PointMapper",
    "RelmapError",
    "__version__",
    "motion_from_velocity",
    "range_bearing_covariances",
]
ROOMS = (
    *("core", "datasets", "evaluation", "exports", "io", "mapper", "merging"),
    *("planes", "planes3d", "plots", "points", "segmentation", "simulation"),
)
"""Packages imported on first access."""
PLACES = {
    "MapperConfig": "core.config",
    "Plane3dMapper": "planes3d",
    "PlaneMapper": "planes",
    "PlaneSegmenter": "segmentation",
    "PointMapper": "points",
    "map_log": "evaluation.run",
    "motion_from_velocity": "core.odometry",
    "range_bearing_covariances": "core.sensor",
}
"""Modules of names imported on first access."""


def __getattr__(name: str) -> Any:
    if name in PLACES:
        return getattr(import_module(f"relmap.{PLACES[name]}"), name)
    if name in ROOMS:
        return import_module(f"relmap.{name}")
    raise AttributeError(f"module 'relmap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *ROOMS, *PLACES})
