"""Whether a cloud shows upright walls, as 2½-D maps need, or floors, ceilings and tilted walls."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError

TILTED = np.sin(np.deg2rad(15.0))
"""Largest vertical component of the normal of an upright surface."""
MOST_SHARE = 0.15
"""Largest fraction of points on surfaces that are not upright."""
POINTS, PATCHES = 10000, 100
"""Number of random points and patches examined."""
LEAST = 10
"""Minimum number of points of a patch."""
RADIUS = 0.15
"""Size of a patch, in heights of the cloud: larger patches would be as high as a low band."""
HEIGHT = (0.05, 0.95)
"""Quantiles that define the height of a cloud."""
FLAT, BROAD = 0.1, 0.15
"""Largest ratio of the least to the middle variance of a surface patch, and smallest ratio of the
middle to the largest: edges and lines have no normal."""


def require_upright(xyz: Floats) -> None:
    """Raise a `RelmapError` if too many surfaces in points (n, 3) are not upright."""
    share = tilted_share(xyz)
    if share > MOST_SHARE:
        raise RelmapError(
            f"{share:.0%} of a scan's points lie on surfaces that are not upright, such as floors, "
            "ceilings or scans of a tilted sensor; expected walls: level such clouds with --level "
            "auto (relmap.segmentation.space.level_scan), or map them with --variant planes3d "
            "(Plane3dMapper)"
        )


def tilted_share(xyz: Floats) -> float:
    """Return the fraction of points (n, 3) around which the surface is not upright."""
    low, high = np.quantile(xyz[:, 2], HEIGHT)
    some = np.random.default_rng(0).permutation(xyz)[:POINTS]
    middles = some[:PATCHES]
    tilted = 0
    for rows in cKDTree(some).query_ball_point(middles, RADIUS * (high - low)):
        if len(rows) >= LEAST:
            variance, axes = np.linalg.eigh(np.cov(some[rows], rowvar=False))
            surface = variance[0] < FLAT * variance[1] and variance[1] > BROAD * variance[2]
            tilted += surface and abs(axes[2, 0]) > TILTED
    return tilted / len(middles)
