"""Rebuilding a map from confirmed observations, where ids are wrong.

Wrong ids are seldom repeated, so an id seen several times at one place in a segment is right. A few
others, seen together, can place landmarks or whole stretches elsewhere. Confirmed observations then
contradict the map, and a map built from them alone shows what they determine, in several submaps if
nothing confirmed connects them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import LENGTH, SegmentRows
from relmap.core.refinement.extending import extend_submaps
from relmap.core.state.table import NONE

AWAY = 2
"""Segments without a landmark after which it is seen on another visit."""
SHARED, SIGMAS = 3, 6.0
"""Landmarks at the same distance from it, up to so many deviations of an observation, that confirm
that two visits show the same landmark."""


def seen_in(rows: SegmentRows, at_least: int) -> SegmentRows:
    """Return the rows of landmarks seen in enough iterations of their segment."""
    return rows.only(np.flatnonzero(rows.n_seen >= at_least))


def without_namesakes(rows: SegmentRows, times: int) -> tuple[SegmentRows, Ints]:
    """Return the rows without visits that other landmarks do not confirm, where ids return.

    A landmark seen again is among landmarks that it was among before, at the same distances; one
    that was given its id elsewhere is not. Of the visits that confirm each other those with most
    observations are kept. Also returns the landmarks (k,) of rows of enough observations (`times`)
    that are left out: two landmarks share an id.
    """
    ends = np.searchsorted(rows.segment, np.arange(rows.n_segments + 1))
    order = np.argsort(rows.landmark, kind="stable")
    landmark, when = rows.landmark[order], rows.first_iteration[rows.segment[order]]
    new = np.append(True, np.diff(landmark) != 0)
    visits = np.split(order, np.flatnonzero(new | (np.diff(when, prepend=0) > LENGTH * AWAY))[1:])
    kept = np.ones(len(order), dtype=bool)
    places: list[_Place] = []
    for k, visit in enumerate(visits):
        if k and rows.landmark[visit[0]] != rows.landmark[visits[k - 1][0]]:
            _drop_rarer(places, kept)
            places = []
        own = _Place(visit, *_company(rows, ends, visit), int(rows.n_seen[visit].sum()))
        same = [other for other in places if other.agrees(own, SIGMAS * rows.noise_m)]
        places = [other for other in places if other not in same]
        places.append(_united([*same, own]))
    _drop_rarer(places, kept)
    shared = np.unique(rows.landmark[~kept & (rows.n_seen >= times)])
    return rows.only(np.flatnonzero(kept)), shared


@dataclass(frozen=True, eq=False)
class _Place:
    """Visits of one id that show the same landmark.

    `rows` (n,): its observations; `others` (k,), ascending: landmarks in the same segments;
    `apart_m` (k,): their distances from it, metres; `n_seen`: number of its observations.
    """

    rows: Ints
    others: Ints
    apart_m: Floats
    n_seen: int

    def agrees(self, other: _Place, tolerance_m: float) -> bool:
        """Return whether enough landmarks are at the same distance in both."""
        _, here, there = np.intersect1d(self.others, other.others, True, return_indices=True)
        off_m = np.abs(self.apart_m[here] - other.apart_m[there])
        return bool(np.count_nonzero(off_m <= tolerance_m) >= SHARED)


def _company(rows: SegmentRows, ends: Ints, visit: Ints) -> tuple[Ints, Floats]:
    """Return the landmarks (k,) in the segments of some rows of one, and their distances (k,)."""
    others = [np.arange(*ends[[s, s + 1]]) for s in rows.segment[visit].tolist()]
    own = np.repeat(visit, [len(each) for each in others])
    of = np.concatenate(others)
    own, of = own[of != own], of[of != own]
    numbers, first = np.unique(rows.landmark[of], return_index=True)
    return numbers, np.linalg.norm(rows.points[of] - rows.points[own], axis=1)[first]


def _united(places: list[_Place]) -> _Place:
    """Return several visits as one."""
    others, first = np.unique(np.concatenate([one.others for one in places]), return_index=True)
    apart_m = np.concatenate([one.apart_m for one in places])[first]
    rows = np.concatenate([one.rows for one in places])
    return _Place(rows, others, apart_m, sum(one.n_seen for one in places))


def _drop_rarer(places: list[_Place], kept: Bools) -> None:
    """Mark the rows of all places of an id but the most observed one as not kept (n,)."""
    for place in sorted(places, key=lambda one: -one.n_seen)[1:]:
        kept[place.rows] = False


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
