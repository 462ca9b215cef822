"""Common points of two maps, and the motion between the frames of the maps."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import mutual, nearest
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.geometry.motions import transforms

SPACING = 0.25
"""Largest distance between two landmarks that are the same, in median distances of neighbours."""
SIGMAS = 4.0
"""The same in standard deviations of the distances of such pairs, once these are known."""
ROUNDS = 4


def moved(points: Floats, T: Floats) -> Floats:
    """Return points (n, d), d of 2 or 3, moved by a motion (4, 4), planar if d is 2."""
    d = points.shape[1]
    return points @ T[:d, :d].T + T[:d, 3]


def paired(points: Floats, among: Floats, T: Floats) -> tuple[Floats, Ints]:
    """Fit a motion to the common landmarks, and return them.

    `points` (n, d), `among` (m, d), metres: points of two maps, each in its own frame; `T` (4, 4):
    approximate motion from the first frame to the second. Returns `T`, fitted, and `pairs` (k, 2):
    rows of both; each occurs at most once.
    """
    spacing = nearest(cKDTree(among), among, 2)[0][:, -1]
    near_m = SPACING * float(np.median(spacing))
    pairs = np.empty((0, 2), dtype=np.int64)
    for _ in range(ROUNDS):
        pairs = np.column_stack(mutual(moved(points, T), among, near_m))
        if len(pairs) <= points.shape[1]:
            break
        source, target = points[pairs[:, 0]], among[pairs[:, 1]]
        T = transforms(*fit_rigid(source, target))
        off = np.linalg.norm(moved(source, T) - target, axis=1)
        near_m = min(near_m, SIGMAS * max(float(np.sqrt(np.mean(off**2))), 1e-9))
    return T, pairs
