"""Landmarks that turn out to be the same are merged in all that is kept of them (section III)."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from relmap.core.building import MapBuilder
from relmap.core.merging import Merger
from relmap.core.store import ObservationStore
from relmap.core.tying import neighbourhoods, tie_pieces

ROUNDS = 5
"""How often doubles are looked for in a row, as each merge tells of others."""


class State(Protocol):
    """Something that is kept of each landmark."""

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark go on in place of a new one, which turned out to be it."""
        ...


class SeenAgain:
    """Merges landmarks with those that they are, seen before and lost.

    Parameters
    ----------
    merger : Merger
        Finds them.
    store : ObservationStore
    builder : MapBuilder
    states : tuple of State
        What else is kept of each landmark, in the order of merging.
    """

    def __init__(
        self,
        merger: Merger,
        store: ObservationStore,
        builder: MapBuilder,
        states: tuple[State, ...],
    ) -> None:
        self.merger = merger
        self._store = store
        self._builder = builder
        self._states = states

    def merge(self, placed: NDArray[np.int64]) -> int:
        """Merge landmarks (k,) that were just placed with older ones; return how many were."""
        levels, noise_m = self._builder.levels.highest[placed], self._builder.noise.sigma_m
        pairs = self.merger.find(placed, levels, noise_m).tolist()
        for new, old in pairs:
            self._store.relabel(new, old)
            for state in (*self._states, self.merger):
                state.merge(new, old)
        return len(pairs)

    def merge_doubles(self) -> bool:
        """Merge landmarks that are the same by where they lie now; tell whether there were any."""
        places, merged = self._builder.map, 0
        for _ in range(ROUNDS):
            before, doubles = merged, self.merger.doubles()
            for around in neighbourhoods(places.positions[doubles]):
                there = doubles[around]
                merged += self.merge(there[places.weights[there] > 0])
            if merged == before:
                break
        return merged > 0

    def tie_pieces(self) -> None:
        """Tie pieces of the map that show the same place, and merge what both saw of it."""
        for _ in tie_pieces(self._builder.map, self._builder.noise.sigma_m):
            self.merge_doubles()
