"""The global map, into which the relative maps of the groups are placed (section III)."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from relmap.core.state.table import NONE, LandmarkState

LOOSE, LOOSE_SUBMAP = 30.0, 1e4
"""Largest variance of a position, relative to the landmarks fitted to, for it to be mapped, and for
it to connect submaps, which are refined as a whole."""


def order_of_submaps(n_kept: Ints, n_landmarks: Ints) -> Ints:
    """Return the order of submaps (s,): the first one is the map.

    `n_kept`, `n_landmarks` (s,): numbers of landmarks of the map to which logs are added, and of
    all. Of equal submaps the one that was begun first comes first.
    """
    return np.lexsort((-n_landmarks, -n_kept))


class GlobalMap:
    """Positions of landmarks: the average over the best group of every interval.

    A group that shares too few landmarks with the map starts a new submap, with its own frame. Two
    submaps are joined when a group connects them.

    `kept_until`: iteration before which landmarks were seen in the map to which logs are added; 0
    if there is none. `kept_anchor`: iteration whose pose defined the frame of that map.
    """

    STATE = "_n_submaps kept_until kept_anchor"

    def __init__(self, table: LandmarkState) -> None:
        self.table = table
        self._n_submaps, self.kept_until, self.kept_anchor = 0, 0, 0

    @property
    def ranks(self) -> Ints:
        """Index of each landmark's submap (n,), or `NONE`; 0 is the map: see `order_of_submaps`."""
        submap, ranks = self.table.submap, np.full(len(self.table), NONE)
        members = np.flatnonzero(submap != NONE)
        submaps, of, counts = np.unique(submap[members], return_inverse=True, return_counts=True)
        kept = np.bincount(of[self.table.first[members] < self.kept_until], minlength=len(submaps))
        rank_of = np.empty(len(submaps), dtype=np.int64)
        rank_of[order_of_submaps(kept, counts)] = np.arange(len(submaps))
        ranks[members] = rank_of[of]
        return ranks

    @property
    def first(self) -> int:
        """Number of the submap that is the map, or `NONE` if there is none."""
        return int(self.table.submap[self.ranks == 0].max(initial=NONE))

    def submaps_of(self, landmarks: Ints, at_least: int = 1) -> Ints:
        """Return the submaps that contain enough of the landmarks, the oldest first."""
        own = self.table.submap[landmarks]
        own = own[own != NONE]
        if len(own) and np.count_nonzero(own == own[0]) == len(own):
            return np.asarray(own[:1] if len(own) >= at_least else own[:0])
        submaps, counts = np.unique(own, return_counts=True)
        return np.asarray(submaps[counts >= at_least])

    def weights_in(self, submap: int, landmarks: Ints) -> Floats:
        """Return the weights (g,) of landmarks, 0 outside the submap."""
        return np.where(self.table.submap[landmarks] == submap, self.table.weight[landmarks], 0.0)

    def align(
        self, submap: int, landmarks: Ints, relative_map: Floats, n_iterations: Ints
    ) -> Floats | None:
        """Fit a group's relative map to those of its members that are in a submap.

        The weight of a member combines the iterations averaged into its positions in the map and in
        the group: variances add, so the weights combine harmonically.

        `landmarks` (g,); `relative_map` (g, d), group frame, metres; `n_iterations` (g,):
        iterations averaged into each position of the relative map. Returns (g, d), frame of the
        submap, metres, or None if the members determine no rotation: NaN for landmarks whose
        position is poorly determined by the rotation.
        """
        import relmap.core.map.aligning_kernels as kernels

        columns = self.table.position, self.table.weight, self.table.submap
        placed, is_fixed = kernels.aligned(columns, submap, landmarks, relative_map, n_iterations)
        return placed if is_fixed else None

    def new_submap(self) -> int:
        """Return the number of a new, empty submap."""
        self._n_submaps += 1
        return self._n_submaps - 1

    def place(self, submap: int, landmarks: Ints, positions: Floats, weights: Floats) -> None:
        """Place landmarks (g,) at positions (g, d) of a submap, averaged with settled positions.

        `landmarks` (g,); `positions` (g, d), frame of the submap, metres; `weights` (g,): numbers
        of iterations averaged.
        """
        settled = self.table.settled_weight
        settled[landmarks[self.table.submap[landmarks] != submap]] = 0.0
        total = settled[landmarks] + weights
        share = (weights / total)[:, None]
        before = self.table.settled_position[landmarks]
        self.table.position[landmarks] = before + share * (positions - before)
        self.table.weight[landmarks] = total
        self.table.submap[landmarks] = submap

    def move(self, landmarks: Ints, positions: Floats) -> None:
        """Move mapped landmarks (k,), including their settled positions, to positions (k, d)."""
        self.table.settled_position[landmarks] += positions - self.table.position[landmarks]
        self.table.position[landmarks] = positions

    def join(self, submap: int, landmarks: Ints, positions: Floats) -> None:
        """Join other submaps to one whose landmarks (g,) determine their relative pose."""
        for other in self.submaps_of(landmarks).tolist():
            if other == submap:
                continue
            shared = self.table.submap[landmarks] == other
            there = self.table.position[landmarks[shared]]
            if fixes_rotation(there) and self.is_fixed(other, landmarks[shared]):
                self.tie(other, submap, *fit_rigid(there, positions[shared]))

    def is_fixed(self, submap: int, shared: Ints) -> bool:
        """Return whether some landmarks determine the positions of their whole submap well."""
        import relmap.core.geometry.fitting_kernels as kernels

        members = np.flatnonzero(self.table.submap == submap)
        swing = kernels.swings(self.table.position[members], np.isin(members, shared))
        return bool((swing <= LOOSE_SUBMAP).all())

    def tie(self, other: int, submap: int, R: Floats, t: Floats) -> None:
        """Join a submap to another, in whose frame it lies at R (d, d) and t (d,)."""
        moved = self.table.submap == other
        for places in (self.table.position, self.table.settled_position):
            places[moved] = places[moved] @ R.T + t
        self.table.submap[moved] = submap
