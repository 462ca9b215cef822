"""Common points of two maps, and the motion between the frames of the maps."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion from the frame of one map to that of another: ``R @ p + t``.

    `R` (d, d), `t` (d,).
    """

    R: Floats
    t: Floats

    def apply(self, points: Floats) -> Floats:
        """Return points (n, 3), or (n, d), transformed; z is unchanged if the motion is planar."""
        d = len(self.t)
        moved = points.copy()
        moved[:, :d] = points[:, :d] @ self.R.T + self.t
        return moved

    @property
    def matrix(self) -> Floats:
        """The motion as a (4, 4) matrix."""
        return transforms(self.R, self.t)


def paired(points: Floats, among: Floats, motion: Motion) -> tuple[Motion, Ints]:
    """Fit a motion to the common landmarks, and return them.

    `points` (n, d), `among` (m, d), metres: points of two maps, each in its own frame; `motion`:
    approximate motion from the first frame to the second. Returns `pairs` (k, 2): rows of both;
    each occurs at most once.
    """
    spacing = nearest(cKDTree(among), among, 2)[0][:, -1]
    near_m = SPACING * float(np.median(spacing))
    pairs = np.empty((0, 2), dtype=np.int64)
    for _ in range(ROUNDS):
        pairs = np.column_stack(mutual(motion.apply(points), among, near_m))
        if len(pairs) <= len(motion.t):
            break
        source, target = points[pairs[:, 0]], among[pairs[:, 1]]
        motion = Motion(*fit_rigid(source, target))
        off = np.linalg.norm(motion.apply(source) - target, axis=1)
        near_m = min(near_m, SIGMAS * max(float(np.sqrt(np.mean(off**2))), 1e-9))
    return motion, pairs
