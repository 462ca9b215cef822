"""Scans that could not be matched when they came, found later in the map.

After a sharp turn, or with many missed detections, a scan may share too little with those just
before it. The map contains more: everything seen from there earlier and later.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.reobservation.recognition import ENOUGH, MORE, PlaceFinder
from relmap.core.association.reobservation.tying import BY_CHANCE, CLEAR
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.state.table import NONE, LandmarkState

NEARBY = 100
"""Iterations before and after a stray scan within which its landmarks were seen."""


def find_strays(table: LandmarkState, rows: SegmentRows, noise_m: float) -> Iterator[Ints]:
    """Yield pairs (k, 2) of unmapped tracks and the mapped landmarks that they are.

    `noise_m`: standard deviation of an observed coordinate.
    """
    n, d = rows.n_segments, table.dimension
    mapped = table.weight[table.landmark_of[rows.landmark]] > 0
    free = ~mapped & ~table.dynamic[table.landmark_of[rows.landmark]]
    known, unknown = (np.bincount(rows.segment[which], minlength=n) for which in (mapped, free))
    strays = np.flatnonzero((known <= d) & (unknown >= ENOUGH + MORE * (d - 2)))
    submaps = [np.flatnonzero(table.submap == k) for k in np.unique(table.submap) if k != NONE]
    if not submaps or not len(strays):
        return
    finders = [(own, PlaceFinder(table.position[own], noise_m)) for own in submaps]
    for stray in strays.tolist():
        of = np.flatnonzero((rows.segment == stray) & free)
        of = of[table.weight[table.now(rows.landmark[of])] == 0]
        found = []
        for own, finder in finders:
            when = rows.first_iteration[stray]
            among = table.first[own] <= when + NEARBY
            among &= table.last[own] >= when - NEARBY
            at = _found(finder, rows.points[of], among, len(strays) * len(submaps))
            pairs = np.column_stack([table.now(rows.landmark[of]), own[at]])[at >= 0]
            found.append(pairs[np.unique(pairs[:, 1], return_index=True)[1]])
        *others, best = sorted(found, key=len)
        # A scan that fits several submaps may be of a repeated structure.
        if len(best) and all(len(other) <= CLEAR * len(best) for other in others):
            yield best


def _found(finder: PlaceFinder, points: Floats, among: Bools, searches: int) -> Ints:
    """Return the rows of the map on which points (n, d) lie; -1 if uncertain."""
    places = finder.places(points, among) if among.sum() >= ENOUGH else []
    if not places:
        return np.full(len(points), -1)
    at = finder.landmarks_at(places[0].apply(points), among)
    hits, rival = len(np.unique(at[at >= 0])), finder.elsewhere(points, places)
    sure = finder.by_chance(len(points), hits, rival, searches) <= BY_CHANCE
    return at if sure and rival <= CLEAR * hits else np.full(len(points), -1)
