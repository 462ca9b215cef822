"""Removal of landmarks that exist only because of wrong ids.

An id that occurs only by misreading looks like a landmark. Its observations contradict one another,
or belong to another landmark.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import extent_of
from relmap.core.geometry.robust import EXACT
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.extending import place_rows
from relmap.core.state.table import NONE

FEW = 3
"""Supporting observations that a real landmark needs; and how many times as often another landmark
at the same position must have been observed for this one to be removed."""
FAR, MOST = 8.0, 0.95
"""Deviation from its landmark above which an observation contradicts it, relative to this quantile
over the landmarks of the median deviation of each."""
UNEQUAL = 6.0
"""Largest ratio of that quantile to the median landmark's, which wrong ids do not raise: 5 occurs
in Victoria Park, 3 elsewhere."""


def take_off_misread(global_map: GlobalMap, rows: SegmentRows, few: float = FEW) -> Ints:
    """Unmap landmarks that exist only because of wrong ids, and return them (k,).

    Few observations of such a landmark support its position, and as many contradict it; or it was
    seen a few times at the position of another that was seen more often, and never together with
    it.

    `rows`: rows of all iterations. `few`: supporting observations that save a landmark.
    """
    table, found = global_map.table, []
    landmark = table.now(rows.landmark)
    for submap in sorted(table.submaps):
        misread = np.array([NONE])
        while len(misread):
            misread = _misread(
                table.position, rows, landmark, table.submap[landmark] == submap, few
            )
            table.take_off_map(misread)
            found.append(misread)
    return np.concatenate([np.empty(0, dtype=np.int64), *found])


def _misread(
    positions: Floats, rows: SegmentRows, landmark: Ints, known: Bools, few: float
) -> Ints:
    """Return the landmarks of the known rows (n,) that exist only because of wrong ids."""
    fit = place_rows(rows, landmark, positions, known)
    judged = np.flatnonzero(known & np.isfinite(fit.variance))
    if not len(judged):
        return judged
    of, n_seen = landmark[judged], rows.n_seen[judged]
    apart = np.linalg.norm(fit.placed[judged] - positions[of], axis=1)
    apart /= np.sqrt(fit.variance[judged])
    limit = max(_limit(apart, of), EXACT * extent_of(positions[of]))
    against = np.bincount(of, n_seen * (apart > limit))
    seen = np.bincount(of, n_seen, minlength=len(positions))
    support = seen[: len(against)] - against
    scattered = np.flatnonzero(are_scattered(support, against, few))
    return np.union1d(scattered, _aliases(positions, rows, landmark, limit, seen))


def are_scattered(support: Ints | Floats, against: Ints | Floats, few: float = FEW) -> Bools:
    """Return which landmarks (m,) few observations support, and as many contradict.

    `support`, `against` (m,): the numbers of these; `few`: as for `take_off_misread`.
    """
    return (against > 0) & (support < few) & (support <= against)


def _limit(apart: Floats, of: Ints) -> float:
    """Return the deviation above which an observation contradicts its landmark."""
    order = np.lexsort((apart, of))
    _, first, counts = np.unique(of[order], return_index=True, return_counts=True)
    medians = apart[order][first + (counts - 1) // 2]
    return FAR * float(min(np.quantile(medians, MOST), UNEQUAL * np.median(medians)))


def _aliases(
    positions: Floats, rows: SegmentRows, landmark: Ints, limit_m: float, seen: Ints | Floats
) -> Ints:
    """Return the landmarks seen (m,) a few times at the position of another one."""
    present = np.flatnonzero(seen)
    few = present[seen[present] < FEW]
    near = KDTree(positions[present]).query_ball_point(positions[few], limit_m)
    found = [
        one
        for one, others in zip(few.tolist(), near, strict=True)
        for other in present[others].tolist()
        if seen[other] > FEW * seen[one] and _never_together(rows, landmark, one, other)
    ]
    return np.unique(np.array(found, dtype=np.int64))


def _never_together(rows: SegmentRows, landmark: Ints, one: int, other: int) -> bool:
    """Return whether two landmarks share segments, but no iteration."""
    row, there = np.flatnonzero(landmark == one), np.flatnonzero(landmark == other)
    _, at, of = np.intersect1d(rows.segment[row], rows.segment[there], return_indices=True)
    return len(at) > 0 and not (rows.visible[row[at]] & rows.visible[there[of]]).any()
