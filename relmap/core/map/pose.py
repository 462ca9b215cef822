"""The robot's pose, computed from the map for display only; no mapping step reads it."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.robust import fit_robust_each
from relmap.core.refinement.condensing import LENGTH, NOWHERE, SegmentRows

ABSURD = 0.01
"""Weight of an observation ten times as far off as the least outlier: it has no part in a pose."""


def trajectory(rows: SegmentRows, positions_map: Floats, of: Ints) -> Floats:
    """Return the pose in every iteration (sections I and III).

    Each is the least-squares fit of the observed landmarks to the map. The observations are
    condensed: the points of the segment seen in an iteration are fitted in their place, since the
    residuals within a segment are not explained by a small motion. The fit is robust to a few wrong
    matches.

    `rows`: rows of all iterations; `positions_map` (m, d), map frame, metres: NaN for unmapped
    landmarks; `of` (m,): the landmark that each number stands for, after merging. Returns
    (n_iterations, 4, 4): ``T_map_robot``; NaN if the mapped landmarks in view do not determine a
    pose, or contradict each other.
    """
    n, d = len(rows.iteration_segment), rows.points.shape[1]
    poses = np.full((n, 4, 4), np.nan)
    if not np.isfinite(positions_map).any():
        return poses
    there = positions_map[of[rows.landmark]]
    mapped = np.isfinite(there).all(axis=1)
    seen = (rows.visible[mapped, None] >> np.arange(LENGTH)) & 1 > 0
    row, bit = np.nonzero(seen)
    row = np.flatnonzero(mapped)[row]
    at = rows.first_iteration[rows.segment[row]] + bit
    ones = np.ones(len(row))
    R, t, fixed, weight = fit_robust_each(rows.points[row], there[row], ones, at, n)
    fixed &= np.bincount(at[weight > ABSURD], minlength=n) >= d
    fixed &= rows.iteration_segment != NOWHERE
    poses[fixed] = np.eye(4)
    poses[fixed, :d, :d] = R[fixed] @ rows.R[fixed]
    poses[fixed, :d, 3] = np.einsum("nij,nj->ni", R[fixed], rows.t[fixed]) + t[fixed]
    return poses
