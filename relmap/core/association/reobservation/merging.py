"""Merging landmarks that were lost and seen again (section III).

A landmark that comes back into view starts as a new one and is placed by its own groups. It is then
matched to mapped landmarks: by position if the map is accurate enough there, otherwise by
constellation, the mutual distances of several landmarks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Ints
from relmap.core.association.reobservation.evidence import Evidence, chosen
from relmap.core.association.reobservation.sightings import RARELY, Sightings
from relmap.core.association.reobservation.tying import NEIGHBOURHOOD, OVERLAP
from relmap.core.association.scale import spacing_of
from relmap.core.geometry.spatialindex import SpatialIndex
from relmap.core.model import LandmarkModel
from relmap.core.state.table import NONE, LandmarkState

if TYPE_CHECKING:
    from relmap.core.mapper import RelativeMapper

REACH = 0.35
"""Possible drift of the map, in spacings of its landmarks."""
TOLERANCE = 3.0
"""Largest difference between two positions of one landmark, in standard deviations of an
observation."""
EXACT = 1e-3
"""Minimum tolerance, as a fraction of that reach, for noise-free data."""
SLICE = 500
"""Landmarks re-entered at a time after the map has moved."""
LAST = 2**62
"""Larger than any landmark number."""
ROUNDS = 5
"""Maximum number of passes over duplicates, as each merge may reveal others."""


class Merger:
    """Finds landmarks in view that are older ones seen again.

    `mature`: observations after which a landmark's position is accurate enough to be compared.

    Attributes: `n_undone`: number of wrong merges that were undone later. `sightings`: which
    landmarks were seen together; used when the whole map is searched.
    """

    _index: SpatialIndex | None
    _old_near: dict[int, list[int]]
    STATE = "_index _entered _old_near n_undone"

    def __init__(self, table: LandmarkState, model: LandmarkModel, mature: int) -> None:
        self._table = table
        self._model = model
        self._mature = mature
        self._index = None
        self._entered = LAST
        self._old_near = {}
        self.n_undone = 0
        self.sightings: Sightings | None = None

    def blank(self) -> SpatialIndex:
        """Return an empty index, to be restored."""
        return SpatialIndex(self._table, 1.0)

    def leave(self, landmarks: Ints) -> None:
        """Record that landmarks have left the view: from now on they may be re-observed."""
        if self._index is None or not len(landmarks):
            return
        landmarks = self._model.compared(landmarks)
        for landmark in landmarks.tolist():
            self._old_near.pop(landmark, None)
        self._index.add(landmarks)

    def look_again(self) -> None:
        """Re-enter all landmarks, because the map has moved; `go_on` does it incrementally."""
        self._entered = 0

    def doubles(self, noise_m: float) -> Ints:
        """Return the landmarks (k,) near compatible older ones, to be merged next.

        Current positions are used, after the map has moved or submaps were joined, and however few
        observations a landmark has: the whole map has been adjusted.
        """
        mapped = np.flatnonzero(self._table.weight > 0)
        if self._index is None:  # No group was compared with older ones.
            self._index = self._begun(mapped)
        if self._index is None or not len(mapped):
            return np.empty(0, dtype=np.int64)
        self._index.add(mapped)
        tolerance_m = TOLERANCE * self._model.position_spread * np.nan_to_num(noise_m)
        near = cKDTree(self._table.position[mapped]).query_pairs(
            max(self._index.cell_m, tolerance_m), output_type="ndarray"
        )
        return self._note(mapped[np.vstack([near, near[:, ::-1]])])

    def go_on(self) -> None:
        """Re-enter some more landmarks at their current positions."""
        if self._index is not None and self._entered < len(self._table):
            end = min(self._entered + SLICE, len(self._table))
            landmarks = np.arange(self._entered, end)
            self._index.add(landmarks[self._table.cell[landmarks] != NONE])
            self._entered = end

    def find(self, landmarks: Ints, noise_m: float) -> Ints:
        """Return pairs (k, 2) of a new landmark and the older one that it is.

        `landmarks` (n,): landmarks just placed by a group: at a higher level the position of one is
        more accurate and is compared again; `noise_m`: standard deviation of an observed
        coordinate.
        """
        landmarks = self._model.compared(landmarks)
        if self._index is None:
            self._index = self._begun(landmarks)
        mature = self._table.weight[landmarks] >= self._mature
        levels, asked = self._table.highest_level[landmarks], self._table.asked_level[landmarks]
        ask = landmarks[mature & (levels > asked)]
        self._table.asked_level[landmarks] = np.maximum(asked, levels * mature)
        self._ask(ask)
        if not self._old_near:
            return np.empty((0, 2), dtype=np.int64)
        near = self._old_near
        known = filter(near.__contains__, landmarks.tolist())  # few, and this is fast
        pairs = [(new, old) for new in known for old in near[new]]
        pairs = self._possible(np.array(pairs)) if pairs else pairs
        if not pairs or self._index is None:
            return np.empty((0, 2), dtype=np.int64)
        spread_m = self._model.position_spread * noise_m
        tolerance_m = max(TOLERANCE * spread_m, EXACT * self._index.cell_m)
        evidence = self._evidence(landmarks, tolerance_m)
        return chosen(self._table.position, np.array(pairs), tolerance_m, evidence)

    def _evidence(self, landmarks: Ints, tolerance_m: float) -> Evidence | None:
        """Return the evidence for merges of landmarks (n,) seen together."""
        if self._index is None or self._model.drift_m is not None:
            return None
        first = np.sort(self._table.first[landmarks[self._table.weight[landmarks] > 0]])
        reach_m, d = self._index.cell_m, self._table.dimension
        share = min(np.log(2) * (REACH * tolerance_m / reach_m) ** d, 0.5)
        weight, last = self._table.weight, self._table.last
        return Evidence(first, share, reach_m, weight, last, landmarks, self.sightings)

    def visits(self, doubles: Ints) -> Iterator[Ints]:
        """Yield landmarks (k,) near each other that were seen together, covering all."""
        table, had = self._table, np.zeros(len(self._table), dtype=bool)
        for seed in doubles.tolist():
            if had[seed] or table.weight[seed] == 0:
                continue
            together = (table.since <= table.last[seed]) & (table.last >= table.first[seed])
            there = np.flatnonzero(
                together & (table.weight > 0) & (table.submap == table.submap[seed])
            )
            apart = np.linalg.norm(table.position[there] - table.position[seed], axis=1)
            there = there[np.argsort(apart, kind="stable")[:NEIGHBOURHOOD]]
            had[there[: max(1, len(there) // OVERLAP)]] = True
            yield there

    def merge(self, new: Ints, old: Ints) -> None:
        """Record that landmarks (k,) in view are older ones (k,)."""
        for landmark in new.tolist():
            self._old_near.pop(landmark, None)
        known = set(old.tolist())
        for others in self._old_near.values():
            if not known.isdisjoint(others):
                others[:] = [other for other in others if other not in known]

    def _begun(self, landmarks: Ints) -> SpatialIndex | None:
        reach_m = self._model.drift_m
        if reach_m is None:
            reach_m = REACH * spacing_of(self._table.position[landmarks])
        return SpatialIndex(self._table, reach_m) if 0 < reach_m < np.inf else None

    def _ask(self, landmarks: Ints) -> None:
        """Search for older landmarks near new ones (k,)."""
        if self._index is None or not len(landmarks):
            return
        positions, last = self._table.position, self._table.last[landmarks]
        # Most are seen now too, and are not older ones.
        before = last if self.sightings is None else last + 1
        of, near = self._index.near(positions[landmarks], before)
        if not len(near):
            return
        new = landmarks[of]
        close = np.linalg.norm(positions[near] - positions[new], axis=1) <= self._index.cell_m
        self._note(np.column_stack([new[close], near[close]]))

    def _note(self, pairs: Ints) -> Ints:
        """Keep the possible ones of pairs (k, 2), to be compared; return the landmarks (n,)."""
        found: dict[int, list[int]] = {}
        for new, old in sorted(self._possible(pairs)):
            found.setdefault(new, []).append(old)
        self._old_near.update(found)
        return np.array(list(found), dtype=np.int64)

    def _possible(self, pairs: Ints) -> list[tuple[int, int]]:
        """Return pairs (k, 2) of a landmark and an older one that may be the same.

        They are in one submap, and were never seen together.
        """
        table, (new, old) = self._table, pairs.T
        fits = (table.submap[old] == table.submap[new]) & (table.submap[new] != NONE)
        fits[fits] = self._model.may_be(table, new[fits], old[fits])
        new, old = new[fits], old[fits]
        is_later = (table.last[old] < table.first[new]).tolist()
        found = zip(new.tolist(), old.tolist(), is_later, strict=True)
        return [(one, other) for one, other, later in found if later or self._is_later(one, other)]

    def _is_later(self, new: int, old: int) -> bool:
        table = self._table
        later = table.is_later(new, old)
        if not later and self.sightings is not None:
            order = (table.last[old], old) < (table.last[new], new)
            later = order and not self.sightings.together(new, old, RARELY)
        return bool(later)


def merge_doubles(engine: RelativeMapper, merge: Callable[[Ints], int] | None = None) -> bool:
    """Merge landmarks that coincide at their current positions; return whether there were any.

    `merge`: merges landmarks (k,) with older ones and returns how many; by default as during a run.
    """
    merger, merged, noise_m = engine.merger, 0, engine.noise_m
    merge = merge or partial(engine.merge, noise_m=noise_m)
    for _ in range(ROUNDS):
        before, doubles = merged, merger.doubles(noise_m)
        for there in merger.visits(doubles):
            merged += merge(there)
        if merged == before:
            break
    return merged > 0


def doubtful(table: LandmarkState, rare: Bools, noise_m: float) -> Bools:
    """Return which of some landmarks (m,) may be wrong matches of another.

    `rare` (m,): landmarks with fewer observations than others; `noise_m`: standard deviation of an
    observed coordinate.
    """
    found = np.zeros(len(table), dtype=bool)
    for submap in np.unique(table.submap[rare & (table.submap != NONE)]).tolist():
        own = table.submap == submap
        few, known = np.flatnonzero(own & rare), np.flatnonzero(own & ~rare)
        if len(known):
            distance = cKDTree(table.position[known]).query(table.position[few])[0]
            found[few] = distance <= TOLERANCE * noise_m
    return found
