"""Where a scan was taken, found from nothing but the map: by triangles of neighbours.

Three landmarks near one another make a triangle; the lengths of its sides do not depend on where it
is seen from.  Triangles of the scan are looked up among those of the map by these lengths.  Each
hit says where the scan may lie, and the one that brings most of the scan onto mapped landmarks is
right, if it brings enough.  Against a whole map this beats the largest consistent set of matching
corners: of 15 scans of 20 to 60 landmarks in maps of 1000, that found as many in six times as long.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import betaincinv
from scipy.stats import binom

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import nearest
from relmap.core.association.placement import DISTINCT, Placement, trimmed_fit
from relmap.core.geometry.alignment import fit_rigid_each

NEIGHBOURS = 7
"""Landmarks nearest to one that it makes triangles with."""
SLIM = 0.1
"""A triangle whose sides differ by less than this share of the longest tells nothing."""
HITS = 400
"""Triangles that are tried, those first that agree best."""
ENOUGH, MORE = 5, 2
"""Landmarks that must be found in the plane, and how many more in space."""
SHARE = 0.5
"""Share of the scan that must be found."""
RIVAL = 0.6
"""Share of these that a rival has at least."""
MOST = 20
"""Places that are told apart; nothing tells more where a scan is."""
SIGMAS = 4.0
"""How far off a landmark may be, in standard deviations of an observation."""
EXACT = 1e-3
"""The same in spacings where there is no noise at all; and in spacings at most `COARSE`."""
COARSE = 0.2
REACH = 3.0
"""How far off it may be at first, in tolerances."""


class PlaceFinder:
    """Finds scans in a map.

    Parameters
    ----------
    positions : (m, d) float64, map frame, metres
    noise_m : float
        Standard deviation of an observed coordinate.
    """

    def __init__(self, positions: Floats, noise_m: float) -> None:
        self._positions = positions
        self._among: Bools | None = None
        self._corners, sides = _triangles(positions)
        self._sides = cKDTree(sides) if len(sides) else None
        if self._sides is not None:
            self._tree = cKDTree(positions)
            self._apart_m = float(np.median(nearest(self._tree, positions, 2)[0][:, 1]))
            least, most = EXACT * self._apart_m, COARSE * self._apart_m
            self._tolerance_m = float(np.clip(SIGMAS * noise_m, least, most))

    def find(self, points: Floats) -> Placement | None:
        """Return the placement of a scan's frame in the map's; None where it is not clear.

        Parameters
        ----------
        points : (n, d) float64, robot frame, metres
        """
        places = self.places(points)
        return places[0] if places and is_clear(points, places) else None

    def places(self, points: Floats, among: Bools | None = None) -> list[Placement]:
        """Return where points (n, d) may lie, the best place first, if enough of them agree there.

        The others are its rivals.  Where it is given, only some landmarks (m,) of the map count.
        """
        n, d = points.shape
        self._among = among
        needed = max(ENOUGH + MORE * (d - 2), SHARE * n)
        if self._sides is None or n < needed or self._positions.shape[1] != d:
            return []
        found: list[Placement] = []
        for placement in self._hypotheses(points, RIVAL * needed):
            if not any(self._is_near(points, placement, other) for other in found):
                better = self._settled(points, placement)
                if better is not None and better.n_agreeing >= RIVAL * needed:
                    found.append(better)
            if len(found) == MOST:
                break
        found.sort(key=lambda placement: -placement.n_agreeing)
        return found if found and found[0].n_agreeing >= needed else []

    def landmarks_at(self, points: Floats, among: Bools | None = None) -> Ints:
        """Return the rows of the map that lie at points (n, d), map frame; -1 where none does."""
        self._among = among
        distance, landmark = self._nearest(points)
        return np.where(distance <= self._tolerance_m, landmark, -1)

    def _nearest(self, points: Floats) -> tuple[Floats, Ints]:
        """Return distance and row of the landmark nearest to each point (n, d) that counts."""
        distance, landmark = nearest(self._tree, points, 1 if self._among is None else 3)
        if self._among is None:
            return distance[:, 0], landmark[:, 0]
        counts = np.append(self._among, False)[landmark]
        first = np.argmax(counts, axis=1)[:, None]
        far = np.where(counts, distance, np.inf)
        return np.take_along_axis(far, first, 1)[:, 0], np.take_along_axis(landmark, first, 1)[:, 0]

    def by_chance(self, n: int, n_agreeing: int, elsewhere: int, trials: int) -> float:
        """Return how likely so many of n points would be found in a wrong place.

        Beside the three of the triangle that was looked up.  Landmarks may lie at random, or on
        some lattice: then many of them are found in other places too.

        Parameters
        ----------
        n, n_agreeing : int
        elsewhere : int
            How many are found in the best of the other places.
        """
        # Half of the landmarks have another within `apart_m`, so many of which lie in a tolerance.
        share = np.log(2) * (self._tolerance_m / self._apart_m) ** self._positions.shape[1]
        # What is found elsewhere is the most of all trials.
        if elsewhere > 3:
            share = max(share, float(betaincinv(elsewhere - 3, n - elsewhere + 1, 1 / trials)))
        return trials * float(binom.sf(n_agreeing - 4, n - 3, share))

    def _hypotheses(self, points: Floats, needed: float) -> list[Placement]:
        """Return where triangles found in the map put the scan, the likeliest first.

        Of these the ones that bring enough of it near mapped landmarks.
        """
        corners, sides = _triangles(points)
        if self._sides is None or not len(sides):
            return []
        distance, hit = nearest(self._sides, sides, 4 if self._among is None else 8)
        near = distance <= 2 * self._tolerance_m
        if self._among is not None:
            near[near] = self._among[self._corners[hit[near]]].all(axis=1)
        row, column = np.nonzero(near)
        order = np.argsort(distance[row, column], kind="stable")[:HITS]
        here = points[corners[row[order]]]
        there = self._positions[self._corners[hit[row, column][order]]]
        h, _, d = here.shape
        at, ones = np.repeat(np.arange(h), 3), np.ones(3 * h)
        R, t, fixed = fit_rigid_each(here.reshape(-1, d), there.reshape(-1, d), ones, at, h)
        off = np.einsum("hij,hkj->hki", R, here) + t[:, None] - there
        likely = np.flatnonzero(fixed & (np.abs(off).max(axis=(1, 2)) <= 2 * self._tolerance_m))
        placed = np.einsum("hij,nj->hni", R[likely], points) + t[likely][:, None]
        apart = self._nearest(placed.reshape(-1, d))[0].reshape(len(likely), len(points))
        enough = np.sum(apart <= REACH * self._tolerance_m, axis=1) >= needed
        return [Placement(R[k], t[k], 3) for k in likely[enough]]

    def _settled(self, points: Floats, placement: Placement) -> Placement | None:
        """Fit a placement to all that it brings onto mapped landmarks."""
        reach_m = REACH * self._tolerance_m
        for _ in range(3):
            distance, landmark = self._nearest(placement.apply(points))
            near = np.flatnonzero(distance <= reach_m)
            if len(near) < ENOUGH:
                return None
            fitted = trimmed_fit(points[near], self._positions[landmark[near]], self._tolerance_m)
            if fitted is None:
                return None
            placement, reach_m = fitted, max(reach_m / 2, self._tolerance_m)
        return placement

    def _is_near(self, points: Floats, one: Placement, other: Placement) -> bool:
        """Tell whether two placements are the same but for what settling changes."""
        off = np.abs(one.apply(points) - other.apply(points))
        return bool(off.max() <= REACH * self._tolerance_m)


def is_clear(points: Floats, places: list[Placement]) -> bool:
    """Tell whether the first of some placements of points (n, d) fits far better than others.

    Than those that put them elsewhere, that is.
    """
    return found_elsewhere(points, places) < DISTINCT * places[0].n_agreeing


def found_elsewhere(points: Floats, places: list[Placement]) -> int:
    """Return how many of points (n, d) the next best place brings onto landmarks, elsewhere."""
    there, extent_m = places[0].apply(points), float(np.ptp(points, axis=0).max())
    rivals = [
        other.n_agreeing
        for other in places[1:]
        if np.abs(other.apply(points) - there).max() > 0.1 * extent_m
    ]
    return max(rivals, default=0)


def _triangles(positions: Floats) -> tuple[Ints, Floats]:
    """Return triangles of neighbours as corners (k, 3), and their sides (k, 3), in metres.

    Sides are in ascending order, and each corner stands at the place of the side opposite.
    """
    rank = min(NEIGHBOURS + 1, len(positions))
    if rank < 3:
        return np.empty((0, 3), dtype=np.int64), np.empty((0, 3))
    around = nearest(cKDTree(positions), positions, rank)[1]
    a, b = np.triu_indices(rank - 1, k=1)
    own = np.broadcast_to(around[:, :1], (len(positions), len(a)))
    corners = np.stack([own, around[:, 1:][:, a], around[:, 1:][:, b]], axis=2).reshape(-1, 3)
    corners = np.unique(np.sort(corners, axis=1), axis=0)
    at = positions[corners]
    sides = np.linalg.norm(at[:, [1, 2, 0]] - at[:, [2, 0, 1]], axis=2)
    order = np.argsort(sides, axis=1)
    corners = np.take_along_axis(corners, order, axis=1)
    sides = np.take_along_axis(sides, order, axis=1)
    told = np.diff(sides, axis=1).min(axis=1) > SLIM * sides[:, 2]
    return corners[told], sides[told]
