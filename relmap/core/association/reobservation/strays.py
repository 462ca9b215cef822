"""Scans that could not be matched when they came, found later in the map.

After a sharp turn, or with many missed detections, a scan may share too little with those just
before it. The map contains more: everything seen from there earlier and later.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.reobservation.recognition import BY_CHANCE, ENOUGH, MORE, PlaceFinder
from relmap.core.association.reobservation.tying import CLEAR
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
            mine, its = _found(finder, rows.points[of], among, len(strays) * len(submaps))
            averaged = np.stack([rows.n_seen[of[mine]], table.weight[own[its]]])
            if len(mine) and finder.is_close(rows.points[of[mine]], its, averaged, n_maps=1):
                found.append(np.column_stack([table.now(rows.landmark[of[mine]]), own[its]]))
        *others, best = sorted(found, key=len) or [np.empty((0, 2), dtype=np.int64)]
        # A scan that fits several submaps may be of a repeated structure.
        if len(best) and all(len(other) <= CLEAR * len(best) for other in others):
            yield best


def _found(finder: PlaceFinder, points: Floats, among: Bools, searches: int) -> tuple[Ints, Ints]:
    """Return which points (n, d) lie on which landmarks, once each; none if uncertain."""
    places = finder.places(points, among) if among.sum() >= ENOUGH else []
    if not places:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    at = finder.landmarks_at(places[0].apply(points), among)
    its, mine = np.unique(at, return_index=True)
    mine, its = mine[its >= 0], its[its >= 0]
    rival = finder.elsewhere(points, places)
    sure = finder.by_chance(len(points), len(its), rival, searches) <= BY_CHANCE
    which = slice(None) if sure and rival <= CLEAR * len(its) else slice(0)
    return mine[which], its[which]
