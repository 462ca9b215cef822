"""Whether a log that was added to a map measures other lengths than the map has."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid_each, sums_each
from relmap.core.refinement.condensing import SegmentRows

FEWEST = 3
"""Minimum number of segments of each log."""
LEAST, SIGMAS = 0.003, 6.0
"""Smallest difference of lengths that counts, relative, and in its standard deviations."""
NORMAL = 1.86
"""Standard deviation of a median, times the root of the number, relative to the median absolute
deviation."""


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
    groups = logs[~is_new], logs[is_new]
    before, now = (float(np.median(each)) for each in groups)
    spread = [np.median(np.abs(each - np.median(each))) / np.sqrt(len(each)) for each in groups]
    least = max(LEAST, SIGMAS * NORMAL * float(np.hypot(*spread)))
    return float(np.exp(now - before)) if abs(now - before) > least else None
