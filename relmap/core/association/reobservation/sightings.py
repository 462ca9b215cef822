"""When each track was seen, from the condensed segments."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Ints
from relmap.core.refinement.condensing import LENGTH, SegmentRows
from relmap.core.state.table import LandmarkState

RARELY = 0.25
"""Largest fraction of the scans of a double landmark that show the other one too: where the noise
is large, a new track may take over while the old one is still continued by a neighbour."""
SELDOM = 0.25
"""Minimum fraction of the scans showing its neighbours that must show a landmark too."""


class Sightings:
    """Which landmarks were seen together: in one scan a landmark occurs only once.

    `rows`: by the numbers under which landmarks were seen.
    """

    def __init__(self, rows: SegmentRows, table: LandmarkState) -> None:
        order = np.argsort(rows.landmark, kind="stable")
        self._segment, self._visible = rows.segment[order], rows.visible[order]
        self._begin = np.searchsorted(rows.landmark[order], np.arange(len(table) + 1))
        self._table = table

    def together(self, one: int, other: int, share: float = 0.0) -> bool:
        """Return whether two landmarks share more than a fraction of the scans of the rarer."""
        here, there = map(self._scans, (one, other))
        return len(np.intersect1d(here, there)) > share * min(len(here), len(there))

    def apart(self, pairs: Ints) -> Ints:
        """Return those of pairs (k, 2) of landmarks that no scan shows together."""
        apart = [not self.together(one, other) for one, other in pairs.tolist()]
        return np.asarray(pairs[np.array(apart, dtype=bool)])

    def seen_with_both(self, pairs: Ints, others: Ints) -> Ints:
        """Return the number of others (n,) seen in one scan with each of a pair (k, 2); (k,)."""
        every = np.union1d(pairs, others).tolist()
        scans = {landmark: set(self._scans(landmark).tolist()) for landmark in every}
        met = [
            [
                other not in pair and not any(scans[other].isdisjoint(scans[one]) for one in pair)
                for other in others.tolist()
            ]
            for pair in pairs.tolist()
        ]
        return np.asarray(np.array(met, dtype=np.int64).reshape(len(pairs), -1).sum(axis=1))

    def seldom(self, rare: Bools) -> Bools:
        """Return which mapped landmarks (m,) few of the scans of their neighbours show.

        Such a landmark is mostly a stretch of another one, observed with errors. `rare` (m,):
        landmarks with few observations, which do not count as neighbours.
        """
        table, n = self._table, 2 * self._table.dimension
        found = np.zeros(len(table), dtype=np.bool_)
        for submap in table.submaps:
            own = np.flatnonzero(table.submap == submap)
            known = own[~rare[own]]
            if len(known) <= n:
                continue
            scans = {landmark: self._scans(landmark) for landmark in own.tolist()}
            near = cKDTree(table.position[known]).query(table.position[own], n + 1)[1]
            for landmark, others in zip(own.tolist(), known[near].tolist(), strict=True):
                beside = [scans[other] for other in others if other != landmark][:n]
                times = np.unique(np.concatenate(beside), return_counts=True)[1]
                shown = np.count_nonzero(2 * times > n)
                found[landmark] = len(scans[landmark]) < SELDOM * shown
        return found

    def _scans(self, landmark: int) -> Ints:
        """Return the scans (k,) that show a landmark, ascending."""
        numbers = self._table.members(landmark)
        rows = np.concatenate([np.arange(*self._begin[[k, k + 1]]) for k in numbers])
        bits = (self._visible[rows][:, None] >> np.arange(LENGTH)) & 1 > 0
        return np.unique((LENGTH * self._segment[rows][:, None] + np.arange(LENGTH))[bits])
