"""Whether a log, or another map, has other lengths than the map that it is added to."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import nearest
from relmap.core.geometry.alignment import fit_rigid_each, sums_each
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.scan import TINY

FEWEST = 3
"""Minimum number of segments of each log."""
LEAST, SIGMAS = 0.003, 6.0
"""Smallest difference of lengths that counts, relative, and in its standard deviations."""
NORMAL = 1.86
"""Standard deviation of a median, times the root of the number, relative to the median absolute
deviation."""
NEIGHBOURS = 6
"""Number of distances of each landmark that are compared in two maps."""


def length_ratio(rows: SegmentRows, positions_map: Floats, of: Ints, since: int) -> float | None:
    """Return lengths in scans of an added log relative to earlier scans; None if they are the same.

    Both are compared with the map, segment by segment, so that drift has no influence. The
    difference may be larger, as landmarks are matched where it is small.

    `rows`: of all iterations; `positions_map` (m, d), metres: NaN if not in the map before; `of`
    (m,): landmark of each number; `since`: first iteration of the added log.
    """
    landmark, n = of[rows.landmark], rows.n_segments
    own = np.flatnonzero(np.isfinite(positions_map[landmark, 0]))
    rows, there = rows.only(own), positions_map[landmark[own]]
    at, weight = rows.segment, rows.n_seen.astype(np.float64)
    R, t, fixed = fit_rigid_each(rows.points, there, weight, at, n)
    total = np.maximum(sums_each(weight, at, n), 1.0)
    middle = (sums_each(weight[:, None] * there, at, n) / total[:, None])[at]
    away = np.einsum("nij,nj->ni", R[at], rows.points) + t[at] - middle
    around = there - middle
    sums = np.column_stack([np.sum(each * around, axis=1) for each in (away, around)])
    along, square = sums_each(weight[:, None] * sums, at, n).T
    known = np.flatnonzero(fixed & (along > 0) & (square > 0))
    logs, is_new = np.log(along[known] / square[known]), rows.base[known] >= since
    if min(is_new.sum(), (~is_new).sum()) < FEWEST:
        return None
    return _ratio(logs[is_new], logs[~is_new])


def length_ratio_of_maps(points: Floats, others: Floats) -> float | None:
    """Return lengths of another map relative to those of a map; None if they are the same.

    `points`, `others` (n, d), metres: the common landmarks. Drift hardly changes short distances.
    """
    if len(points) <= NEIGHBOURS:
        return None
    near = nearest(cKDTree(points), points, NEIGHBOURS + 1)[1][:, 1:]
    here, there = (np.linalg.norm(at[near] - at[:, None], axis=2) for at in (points, others))
    logs = np.log(np.maximum(there, TINY)) - np.log(np.maximum(here, TINY))
    return _ratio(np.median(logs, axis=1), np.zeros(1))


def _ratio(*logs: Floats) -> float | None:
    """Return the ratio of lengths, given logarithms of lengths now, and of those before."""
    now, before = (float(np.median(each)) for each in logs)
    spread = [np.median(np.abs(each - np.median(each))) / np.sqrt(len(each)) for each in logs]
    least = max(LEAST, SIGMAS * NORMAL * float(np.hypot(*spread)))
    return float(np.exp(now - before)) if abs(now - before) > least else None
