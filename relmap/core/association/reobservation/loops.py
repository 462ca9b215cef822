"""Loops still open because of drift: places that a submap shows twice.

A neighbourhood of landmarks that were seen together is searched for in the earlier part of the same
submap, at any distance: the drift is not bounded. A match is accepted if it is unlikely by chance
and has no near rival, as with submaps (see `tying`).
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Ints
from relmap.core.association.chance import moved_m
from relmap.core.association.likelihood import LOG_CLEAR
from relmap.core.association.placement import Placement
from relmap.core.association.reobservation.evidence import LOCAL_DRIFT
from relmap.core.association.reobservation.recognition import (
    BY_CHANCE,
    CLEAR,
    ENOUGH,
    SIGMAS,
    PlaceFinder,
)
from relmap.core.association.reobservation.tying import NEIGHBOURHOOD, OVERLAP
from relmap.core.association.scale import spacing_of
from relmap.core.association.soft import SoftMatching, likely_links
from relmap.core.state.table import LandmarkState

FARTHEST = 10.0
"""Possible drift of the map, in standard deviations."""
CROWD = 40
"""Number of landmarks in a neighbourhood where the noise is large."""
TIED = 3
"""Landmarks of a neighbourhood known from before that already close the loop."""


Loop = tuple[Ints, Placement]
"""A place seen twice: pairs (k, 2) of landmarks of the later visit and the older ones they are, and
the placement that maps the positions of the later visit to the correct ones, map frame."""


class LoopFinder:
    """Finds loops in a map, one at a time; each landmark is tried as a starting point once.

    `noise_m`: standard deviation of an observed coordinate; `drift`: variance of the drift of the
    map nearby, relative to that of an observation; `is_blurred`: whether the noise makes many
    single matches ambiguous: loops are then also found by likelihood.
    """

    def __init__(
        self,
        table: LandmarkState,
        noise_m: float,
        *,
        drift: float = LOCAL_DRIFT,
        is_blurred: bool = False,
    ) -> None:
        self._table, self._drift = table, drift
        self._noise_m, self._is_blurred = noise_m, is_blurred
        self._had = np.zeros(len(table), dtype=bool)

    def next(self) -> Loop | None:
        """Return a loop that is still open; None if there are no more."""
        table = self._table
        for submap in sorted(table.submaps):
            own = np.flatnonzero(table.submap == submap)
            if self._had[own].all() or len(own) < 2 * NEIGHBOURHOOD:
                continue
            if table.last[own].min() >= table.since[own].max():
                continue  # every landmark was seen together with every other
            finder = PlaceFinder(table.position[own], self._noise_m, self._drift)
            for seed in own[np.argsort(table.first[own], kind="stable")].tolist():
                loop = None if self._had[seed] else self._loop(finder, own, seed)
                if loop is not None:
                    return loop
        return None

    def _loop(self, finder: PlaceFinder, own: Ints, seed: int) -> Loop | None:
        """Return the loop that the neighbourhood of a landmark closes, if any."""
        table = self._table
        together = own[
            (table.since[own] <= table.last[seed]) & (table.last[own] >= table.since[seed])
        ]
        apart = np.linalg.norm(table.position[together] - table.position[seed], axis=1)
        nearest = together[np.argsort(apart, kind="stable")]
        around = nearest[:NEIGHBOURHOOD]
        self._had[around[: max(1, len(around) // OVERLAP)]] = True
        self._had[seed] = True
        points = table.position[around]
        before = table.last[own] < table.since[around].min()
        is_tied = np.sum(table.since[around] > table.first[around]) >= TIED
        enough = len(around) // 2 if is_tied else ENOUGH
        if before.sum() < enough:
            return None
        old = own[before]
        off = np.linalg.norm(table.position[old] - points.mean(axis=0), axis=1)
        reach_m = np.ptp(points, axis=0).max()
        if not is_tied:
            begin = int(table.last[old].min(initial=table.since[seed]))
            reach_m += self._drift_m(around, together, begin)
        near = off <= reach_m
        before[before] = near
        if near.sum() < enough:
            return None
        loop = self._by_places(finder, own, around, together, before)
        if loop is None and self._is_blurred:
            loop = self._by_likelihood(nearest[:CROWD], own[before], reach_m)
        return loop

    def _by_places(
        self, finder: PlaceFinder, own: Ints, around: Ints, together: Ints, before: Bools
    ) -> Loop | None:
        """Return the loop from landmarks in view to older ones that form the same place."""
        table, points = self._table, self._table.position[around]
        known = finder.recognised(points, before, len(own))
        if known is None:
            return None
        placement, mine, its = known
        pairs = np.column_stack([around[mine], own[its]])
        last = int(table.last[own[its]].max())
        if moved_m(placement, points) > self._drift_m(around, together, last):
            return None
        close = finder.is_close(points[mine], its, table.weight[pairs.T], n_maps=2)
        return (pairs, placement) if close else None

    def _by_likelihood(self, later: Ints, older: Ints, farthest_m: float) -> Loop | None:
        """Return the loop by the most likely shift of later landmarks onto older ones."""
        table = self._table
        older = older[table.last[older] < table.since[later].min()]
        if min(len(later), len(older)) < ENOUGH:
            return None
        weight = np.minimum(table.weight[later], table.observations[later])
        usual = float(np.median(table.weight[older]))
        variance = self._noise_m**2 * (1 / np.maximum(weight, 1) + 1 / usual + LOCAL_DRIFT)
        here, there = table.position[later], table.position[older]
        matching = SoftMatching(here, variance, there, spacing_of(there), None)
        best = matching.found(*matching.by_shifts(farthest_m))
        if best is None:
            return None
        placement, score, rival = best
        d, sigma_m = here.shape[1], float(np.sqrt(np.median(variance)))
        chance = d * (d + 1) / 2 * np.log(1 + farthest_m / sigma_m) - np.log(BY_CHANCE)
        if score < chance or rival > min(score + LOG_CLEAR, CLEAR * score):
            return None
        rows, found = likely_links(placement.apply(here), variance, weight, there, None)
        drift_m = self._drift_m(later, later, int(table.last[older[found]].max(initial=0)))
        if moved_m(placement, here) > drift_m + SIGMAS * self._noise_m:
            return None
        return np.column_stack([later[rows], older[found]]), placement

    def _drift_m(self, around: Ints, together: Ints, begin: int) -> float:
        """Return the possible drift of the map between an iteration and landmarks seen later.

        A random walk of the heading: each time the landmarks in view have been replaced, these
        landmarks transfer the heading, with the accuracy of their observations.
        """
        table = self._table
        middle = table.position[around].mean(axis=0)
        end = int(table.since[around].min())
        spread = table.position[together] - table.position[together].mean(axis=0)
        radius_m = float(np.sqrt(np.mean(np.sum(spread**2, axis=1))))
        length = float(np.median(table.last[together] - table.since[together] + 1))
        turn = self._noise_m * np.sqrt(2 / (len(together) * length)) / max(radius_m, 1e-9)
        between = (table.first >= begin) & (table.first <= end)
        between &= table.submap == table.submap[around[0]]
        away = np.linalg.norm(table.position[between] - middle, axis=1)
        lever_m = away.max(initial=0.0) + radius_m
        return float(FARTHEST * turn * np.sqrt(max(end - begin, 0) / length + 1) * lever_m)
