"""Scans that could not be matched when they came, found later in the map.

After a sharp turn, or with many missed detections, a scan may share too little with those just
before it. The map contains more: everything seen from there earlier and later.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from relmap.core.arrays import Ints
from relmap.core.association.reobservation.recognition import CLEAR, ENOUGH, MORE, PlaceFinder
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.state.table import NONE, LandmarkState

NEARBY = 100
"""Iterations before and after a stray scan within which its landmarks were seen."""


def find_strays(
    table: LandmarkState, rows: SegmentRows, noise_m: float, drift: float
) -> Iterator[Ints]:
    """Yield pairs (k, 2) of unmapped tracks and the mapped landmarks that they are.

    `noise_m`: standard deviation of an observed coordinate; `drift`: variance of the drift of the
    map nearby, relative to that of an observation.
    """
    n, d = rows.n_segments, table.dimension
    mapped = table.weight[table.landmark_of[rows.landmark]] > 0
    free = ~mapped & ~table.dynamic[table.landmark_of[rows.landmark]]
    known, unknown = (np.bincount(rows.segment[which], minlength=n) for which in (mapped, free))
    strays = np.flatnonzero((known <= d) & (unknown >= ENOUGH + MORE * (d - 2)))
    submaps = [np.flatnonzero(table.submap == k) for k in np.unique(table.submap) if k != NONE]
    if not submaps or not len(strays):
        return
    finders = [(own, PlaceFinder(table.position[own], noise_m, drift)) for own in submaps]
    for stray in strays.tolist():
        of = np.flatnonzero((rows.segment == stray) & free)
        of = of[table.weight[table.now(rows.landmark[of])] == 0]
        found = []
        for own, finder in finders:
            when = rows.first_iteration[stray]
            among = table.first[own] <= when + NEARBY
            among &= table.last[own] >= when - NEARBY
            placed = finder.recognised(rows.points[of], among, len(strays) * len(submaps))
            if placed is None:
                continue
            mine, its = of[placed[1]], placed[2]
            averaged = np.stack([rows.n_seen[mine], table.weight[own[its]]])
            if finder.is_close(rows.points[mine], its, averaged, n_maps=1):
                found.append(np.column_stack([table.now(rows.landmark[mine]), own[its]]))
        *others, best = sorted(found, key=len) or [np.empty((0, 2), dtype=np.int64)]
        # A scan that fits several submaps may be of a repeated structure.
        if len(best) and all(len(other) <= CLEAR * len(best) for other in others):
            yield best
