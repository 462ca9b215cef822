"""Rebuilding a map from confirmed observations, where ids are wrong.

Wrong ids are seldom repeated, so an id seen several times at one place in a segment is right. A few
others, seen together, can place landmarks or whole stretches elsewhere. Confirmed observations then
contradict the map, and a map built from them alone shows what they determine, in several submaps if
nothing confirmed connects them.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Ints
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.extending import extend_submaps
from relmap.core.state.table import NONE


def seen_in(rows: SegmentRows, at_least: int) -> SegmentRows:
    """Return the rows of landmarks seen in enough iterations of their segment."""
    return rows.only(np.flatnonzero(rows.n_seen >= at_least))


def found_rest(global_map: GlobalMap, sure: SegmentRows, least: int = 0) -> None:
    """Start submaps, each from the segment with most unmapped landmarks, as long as there are many.

    `sure`: confirmed rows of all iterations; `least`: landmarks of a submap that is kept.
    """
    table = global_map.table
    landmark, tried = table.now(sure.landmark), np.zeros(sure.n_segments, dtype=bool)
    while True:
        free = (table.submap[landmark] == NONE) & ~table.dynamic[landmark]
        free &= ~tried[sure.segment]
        counts = np.bincount(sure.segment[free], minlength=sure.n_segments)
        if counts.max(initial=0) < 2 * table.dimension:
            return
        tried[counts.argmax()] = True
        _found(global_map, sure, np.flatnonzero(free & (sure.segment == counts.argmax())), least)


def _found(global_map: GlobalMap, sure: SegmentRows, rows: Ints, least: int) -> None:
    """Start a submap from rows (k,) of one segment, and extend it by unmapped landmarks."""
    table = global_map.table
    # A landmark has several rows if its tracks were merged.
    landmarks, of = np.unique(table.now(sure.landmark[rows]), return_inverse=True)
    seen = sure.n_seen[rows].astype(np.float64)
    weights = np.asarray(np.bincount(of, seen), dtype=np.float64)
    points = np.zeros((len(landmarks), table.dimension))
    np.add.at(points, of, seen[:, None] * sure.points[rows])
    submap = global_map.new_submap()
    global_map.place(submap, landmarks, points / weights[:, None], weights)
    extend_submaps(global_map, sure, table.submap == NONE)
    own = np.flatnonzero(table.submap == submap)
    if len(own) < least:
        table.take_off_map(own)
