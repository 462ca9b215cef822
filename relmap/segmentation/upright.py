"""Whether a cloud shows upright walls, as 2½-D maps need, or floors, ceilings and tilted walls."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.segmentation.space import PatchSegmenter

TILTED = np.sin(np.deg2rad(15.0))
"""Largest vertical component of the normal of an upright plane."""
MOST_SHARE = 0.15
"""Largest fraction of points on planes that are not upright."""


def require_upright(xyz: Floats) -> None:
    """Raise a `RelmapError` if too many points (n, 3) lie on planes that are not upright."""
    share = tilted_share(xyz)
    if share > MOST_SHARE:
        raise RelmapError(
            f"{share:.0%} of a scan's points lie on surfaces that are not upright, such as floors, "
            "ceilings or scans of a tilted sensor; expected walls: level such clouds with --level "
            "auto (relmap.segmentation.space.level_scan), or map them with --variant planes3d "
            "(Plane3dMapper)"
        )


def tilted_share(xyz: Floats) -> float:
    """Return the fraction of points (n, 3) on planes that are not upright."""
    segmenter = PatchSegmenter().fit(xyz)
    tilted = np.abs(segmenter.patches_.normal[:, 2]) > TILTED
    return float(np.append(tilted, False)[segmenter.labels_].mean())
