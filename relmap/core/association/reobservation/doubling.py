"""Places that a refined map shows twice, one beside the other.

Wrong merges can tie a stretch to the map where it does not belong. Its landmarks are then beside
those that they are, all shifted alike, and were never seen in one scan with them, although they lie
among landmarks that were. Time does not tell the two stretches apart: both may have been visited
again in between.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, QhullError, cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.placement import Placement, consistent_placements
from relmap.core.association.reobservation.evidence import ENOUGH, LOG_CHANCE
from relmap.core.association.reobservation.recognition import EXACT
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.association.reobservation.tying import CLEAR, NEIGHBOURHOOD, OVERLAP
from relmap.core.association.scale import spacing_of
from relmap.core.association.search import log_chance
from relmap.core.state.table import NONE, LandmarkState

AMONG = 0.25
"""Fraction of the matches of a stretch that must lie in the convex hull of what was seen with the
landmark amid the neighbourhood: the two faces of a wall are not seen together either."""
CANDIDATES = 400
"""Maximum number of candidate pairs, the nearest."""


def places_shown_twice(
    table: LandmarkState, sightings: Sightings, tolerance_m: float
) -> Iterator[Ints]:
    """Yield pairs (k, 2) of landmarks of a stretch and those that they are, beside it.

    `table`: of a refined map; `tolerance_m`: largest distance between the positions of one landmark
    after placement.
    """
    for submap in np.unique(table.submap[table.submap != NONE]).tolist():
        own = np.flatnonzero(table.submap == submap)
        if len(own) < 2 * NEIGHBOURHOOD or not spacing_of(table.position[own]) > 0:
            continue
        if table.last[own].min() >= table.since[own].max():
            continue  # every landmark was seen together with every other
        search = _Search(table.position[own], sightings.met(own), tolerance_m)
        had = np.zeros(len(own), dtype=np.bool_)
        for seed in range(len(own)):
            if had[seed]:
                continue
            together, around = search.neighbourhood(seed)
            if len(around) <= ENOUGH:
                continue
            had[around[: max(1, len(around) // OVERLAP)]] = True
            pairs = search.pairs(seed, together, around)
            if len(pairs):
                had[pairs] = True
                yield own[pairs]


class _Search:
    """Searches for shifted stretches around one landmark after another.

    `at` (m, d), metres: positions; `met` (m, m): which landmarks were seen in one scan.
    """

    def __init__(self, at: Floats, met: csr_array, tolerance_m: float) -> None:
        self._at, self._met, self._tree = at, met, cKDTree(at)
        self._apart_m = spacing_of(at)
        self._tolerance_m = max(tolerance_m, EXACT * self._apart_m)

    def neighbourhood(self, seed: int) -> tuple[Ints, Ints]:
        """Return the landmarks seen with one of them, and the nearest of these; nearest first."""
        begin, end = self._met.indptr[[seed, seed + 1]]
        together: Ints = self._met.indices[begin:end].astype(np.int64)
        apart = np.linalg.norm(self._at[together] - self._at[seed], axis=1)
        together = together[np.argsort(apart, kind="stable")]
        return together, together[:NEIGHBOURHOOD]

    def pairs(self, seed: int, together: Ints, around: Ints) -> Ints:
        """Return pairs (k, 2) of a stretch and a neighbourhood that one motion brings together.

        None unless sure.
        """
        none = np.empty((0, 2), dtype=np.int64)
        at, d, tolerance_m = self._at, self._at.shape[1], self._tolerance_m
        reach_m = float(np.linalg.norm(at[around[-1]] - at[seed]))
        strangers, pairs = self._candidates(seed, together, around, reach_m)
        found = consistent_placements(at, at, pairs, tolerance_m, tolerance_m)
        placement, matches = next(found, (None, pairs[:0]))
        if placement is None:
            return none
        rival = len(next(found, (None, pairs[:0]))[1])
        matches = self._one_to_one(placement, matches)
        if rival > CLEAR * len(matches):
            return none
        share = min(np.log(2) * (tolerance_m / self._apart_m) ** d, 0.5)
        placements = d * (d + 1) / 2 * np.log(1 + 2 * reach_m / tolerance_m) + np.log(len(at))
        if log_chance(len(strangers), len(matches), share, placements) > LOG_CHANCE:
            return none
        inside = _inside(at[matches[:, 0]], at[together])
        return matches if inside.mean() >= AMONG else none

    def _candidates(
        self, seed: int, together: Ints, around: Ints, reach_m: float
    ) -> tuple[Ints, Ints]:
        """Return landmarks (n,) near one of them that were not seen with it.

        And pairs (k, 2) of these and those around it that they may be, the nearest first.
        """
        near = np.array(sorted(self._tree.query_ball_point(self._at[seed], reach_m)))
        strangers = near[~np.isin(near, together)]
        if len(strangers) < ENOUGH:
            return strangers, np.empty((0, 2), dtype=np.int64)
        one, other = np.nonzero(~self._met[strangers][:, around].toarray())
        pairs = np.column_stack([strangers[one], around[other]])
        apart = np.linalg.norm(self._at[pairs[:, 0]] - self._at[pairs[:, 1]], axis=1)
        return strangers, pairs[np.argsort(apart, kind="stable")[:CANDIDATES]]

    def _one_to_one(self, placement: Placement, matches: Ints) -> Ints:
        """Return matches (k, 2) that a placement brings together, each landmark once."""
        off = placement.apply(self._at[matches[:, 0]]) - self._at[matches[:, 1]]
        matches = np.asarray(matches[np.linalg.norm(off, axis=1) <= self._tolerance_m])
        for column in (0, 1):
            matches = matches[np.unique(matches[:, column], return_index=True)[1]]
        return matches


def _inside(points: Floats, others: Floats) -> Bools:
    """Return which points (n, d) are in the convex hull of others (m, d)."""
    try:
        faces = ConvexHull(others).equations
    except QhullError:  # too few, or all in one plane
        return np.zeros(len(points), dtype=np.bool_)
    return np.asarray((points @ faces[:, :-1].T + faces[:, -1] <= 0).all(axis=1))
