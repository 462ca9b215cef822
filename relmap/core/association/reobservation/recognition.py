"""Place recognition from the map alone, by triangles of neighbouring landmarks.

Three neighbouring landmarks form a triangle whose side lengths do not depend on the viewpoint.
Triangles of the scan are looked up among those of the map by these lengths. Each hit gives a
candidate placement; the one that brings most of the scan onto mapped landmarks is accepted if it
brings enough. Searching the maximum clique of matching corners instead finds as many of 15 scans of
20 to 60 landmarks in maps of 1000, but takes six times as long.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import bdtrc, betaincinv

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.base import nearest
from relmap.core.association.placement import DISTINCT, Placement
from relmap.core.association.reobservation.evidence import LOCAL_DRIFT
from relmap.core.geometry.alignment import fit_rigid, fit_rigid_each

NEIGHBOURS = 7
"""Number of nearest landmarks with which a landmark forms triangles."""
SLIM = 0.1
"""A triangle whose sides differ by less than this fraction of the longest is ambiguous."""
HITS = 400
"""Maximum number of triangle matches tried, best first."""
ENOUGH, MORE = 5, 2
"""Landmarks that must be found in the plane, and how many more in space."""
SHARE = 0.5
"""Fraction of the scan that must be found."""
RIVAL = 0.6
"""Minimum fraction of these found by a rival."""
MOST, AT_ONCE = 20, 50
"""Maximum number of distinct places considered, as with more the scan is ambiguous anyway; and of
candidates that are fitted at once."""
SIGMAS = 4.0
"""Tolerance of a landmark's position, in standard deviations of an observation."""
EXACT = 1e-3
"""The same in spacings for noise-free data; and the upper limit in spacings, `COARSE`."""
COARSE = 0.2
MISFIT = 2.5
"""Largest variance of found landmarks, relative to that expected: where a pattern repeats, another
place agrees within the tolerance, but less closely."""
BY_CHANCE = 1e-3
"""Accepted expected number of false matches of random landmarks, over all searches."""
CLEAR = 0.6
"""Fraction of the landmarks of a place that may be found in another."""
REACH, SETTLING = 3.0, 3
"""Initial tolerance, in units of the final one, and number of fits to what is within it."""


class PlaceFinder:
    """Localises scans in a map.

    `positions` (m, d), map frame, metres; `noise_m`: standard deviation of an observed coordinate;
    `drift`: variance of the drift of the map nearby, relative to that of an observation.
    """

    def __init__(self, positions: Floats, noise_m: float, drift: float = LOCAL_DRIFT) -> None:
        self._drift = drift
        self._positions = positions
        self._among: Bools | None = None
        self._n_tried = 0
        self._corners, sides = triangles(positions)
        self._sides, self.spacing_m = cKDTree(sides) if len(sides) else None, np.inf
        if self._sides is not None:
            self._tree = cKDTree(positions)
            self.spacing_m = _spacing_of(self._tree, positions)
            least, most = EXACT * self.spacing_m, COARSE * self.spacing_m
            self._tolerance_m = float(np.clip(SIGMAS * noise_m, least, most))
            self._noise_m = max(noise_m, least / SIGMAS)

    def is_certain(self, points: Floats, places: list[Placement], searches: int) -> bool:
        """Return whether the first placement of points (n, d) fits far better than all others.

        It must also fit better than chance would explain in as many `searches`.
        """
        rival, n_agreeing = self.elsewhere(points, places), places[0].n_agreeing
        if rival >= DISTINCT * n_agreeing:
            return False
        return self.by_chance(len(points), n_agreeing, rival, searches) <= BY_CHANCE

    def recognised(
        self, points: Floats, among: Bools, searches: int
    ) -> tuple[Placement, Ints, Ints] | None:
        """Return where points (n, d) are among some landmarks (m,); None if uncertain.

        Returns the placement, and which points (k,) lie on which landmarks (k,), each once.
        `searches`: see `by_chance`.
        """
        places = self.places(points, among)
        if not places:
            return None
        its, mine = np.unique(self.landmarks_at(places[0].apply(points), among), return_index=True)
        mine, its = mine[its >= 0], its[its >= 0]
        rival = self.elsewhere(points, places)
        sure = self.by_chance(len(points), len(its), rival, searches) <= BY_CHANCE
        return (places[0], mine, its) if sure and rival <= CLEAR * len(its) else None

    def places(
        self, points: Floats, among: Bools | None = None, share: float = SHARE
    ) -> list[Placement]:
        """Return candidate placements of points (n, d), best first, if enough points agree.

        At least a `share` of them. The others are rivals of the first. If given, only some
        landmarks (m,) of the map count.
        """
        n, d = points.shape
        self._among = among
        needed = max(ENOUGH + MORE * (d - 2), share * n)
        if self._sides is None or n < needed or self._positions.shape[1] != d:
            return []
        R, t = self._hypotheses(points, RIVAL * needed)
        found: list[Placement] = []
        for k in range(0, len(R), AT_ONCE):
            if len(found) == MOST:
                break
            there = points @ R[k : k + AT_ONCE].transpose(0, 2, 1) + t[k : k + AT_ONCE, None]
            self._add_settled(points, there, RIVAL * needed, found)
        found.sort(key=lambda placement: -placement.n_agreeing)
        return found if found and found[0].n_agreeing >= needed else []

    def _add_settled(
        self, points: Floats, placed: Floats, needed: float, found: list[Placement]
    ) -> None:
        """Add candidate placements, settled, to those found, unless they began near one of them.

        `points` (n, d); `placed` (h, n, d): after each placement.
        """
        near_m = REACH * self._tolerance_m  # equal up to the changes made by fitting
        left = np.ones(len(placed), dtype=np.bool_)
        for other in found:
            left &= np.abs(placed - other.apply(points)).max(axis=(1, 2)) > near_m
        placed = placed[left]
        R, t, n_agreeing = self._settled(points, placed)
        left = n_agreeing >= needed
        while left.any() and len(found) < MOST:
            k = int(left.argmax())
            found.append(Placement(R[k], t[k], int(n_agreeing[k])))
            left[k] = False
            left &= np.abs(placed - found[-1].apply(points)).max(axis=(1, 2)) > near_m

    def landmarks_at(self, points: Floats, among: Bools | None = None) -> Ints:
        """Return the rows of the map that lie at points (n, d), map frame; -1 if none does."""
        self._among = among
        distance, landmark = self._nearest(points)
        return np.where(distance <= self._tolerance_m, landmark, -1)

    def elsewhere(self, points: Floats, places: list[Placement]) -> int:
        """Return how many of points (n, d) the best placement elsewhere brings onto landmarks.

        Most points are elsewhere; they need not be far, as on a lattice.
        """
        if not places:
            return 0
        there, apart_m = places[0].apply(points), REACH * self._tolerance_m
        rivals = [
            other.n_agreeing
            for other in places[1:]
            if np.median(np.linalg.norm(other.apply(points) - there, axis=1)) > apart_m
        ]
        return max(rivals, default=0)

    def is_close(self, points: Floats, at: Ints, n_averaged: Floats, n_maps: int) -> bool:
        """Return whether points (k, d) agree with landmarks (k,) as closely as noise allows.

        `n_averaged` (2, k): observations averaged into the points and the landmarks; `n_maps`: 2 if
        the points are of a map, too, which drifts, 1 if they are of a segment.
        """
        there, (n, d) = self._positions[at], points.shape
        variance = (1 / np.maximum(n_averaged, 1)).sum(axis=0) + n_maps * self._drift
        R, t = fit_rigid(points, there)
        square = np.sum((points @ R.T + t - there) ** 2, axis=1)
        freedom = n * d - d * (d + 1) / 2
        return bool(np.sum(square / variance) <= MISFIT * freedom * self._noise_m**2)

    def _nearest(self, points: Floats) -> tuple[Floats, Ints]:
        """Return distance and row of the nearest counted landmark for each point (n, d)."""
        distance, landmark = nearest(self._tree, points, 1 if self._among is None else 3)
        if self._among is None:
            return distance[:, 0], landmark[:, 0]
        counts = np.append(self._among, False)[landmark]
        first = np.argmax(counts, axis=1)[:, None]
        far = np.where(counts, distance, np.inf)
        return np.take_along_axis(far, first, 1)[:, 0], np.take_along_axis(landmark, first, 1)[:, 0]

    def by_chance(self, n: int, n_agreeing: int, elsewhere: int, searches: int) -> float:
        """Return the expected number of wrong places where as many of n points are found.

        The three of the triangle do not count. Landmarks may lie at random or on a lattice; in the
        latter case many are found in other places too.

        `elsewhere`: number found in the best of the other places; `searches`: number of searches
        like the last one, each with as many triangles that fit.
        """
        trials = searches * max(self._n_tried, 1)
        # Half of the landmarks have another within `spacing_m`; the fraction of that area in a
        # tolerance.
        share = np.log(2) * (self._tolerance_m / self.spacing_m) ** self._positions.shape[1]
        # The number found elsewhere is the maximum of all trials.
        if elsewhere > 3:
            share = max(share, float(betaincinv(elsewhere - 3, n - elsewhere + 1, 1 / trials)))
        return trials * float(bdtrc(n_agreeing - 4, n - 3, share))

    def _hypotheses(self, points: Floats, needed: float) -> tuple[Floats, Floats]:
        """Return rotations (h, d, d) and translations (h, d) of the scan, best first."""
        corners, sides = triangles(points)
        if self._sides is None or not len(sides):
            d = points.shape[1]
            return np.empty((0, d, d)), np.empty((0, d))
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
        self._n_tried = len(likely)
        enough = np.sum(apart <= REACH * self._tolerance_m, axis=1) >= needed
        return R[likely[enough]], t[likely[enough]]

    def _settled(self, points: Floats, placed: Floats) -> tuple[Floats, Floats, Ints]:
        """Fit placements to all points that they bring onto mapped landmarks.

        `points` (n, d); `placed` (h, n, d): after each placement. Returns R (h, d, d); t (h, d);
        and the numbers (h,) of points that agree, -1 if too few do.
        """
        from relmap.core.geometry.fitting_kernels import trimmed_fit_each

        h, n, d = placed.shape
        R, t, n_agreeing = np.zeros((h, d, d)), np.zeros((h, d)), np.zeros(h, dtype=np.int64)
        reach_m, left = REACH * self._tolerance_m, np.arange(h)
        for _ in range(SETTLING):
            if not len(left):
                break
            distance, landmark = self._nearest(placed.reshape(-1, d))
            near = (distance <= reach_m).reshape(-1, n)
            target = self._positions[landmark % len(self._positions)].reshape(-1, n, d)
            turn, shift = R[left], t[left]
            agree = trimmed_fit_each(points, target, near, self._tolerance_m, ENOUGH, turn, shift)
            R[left], t[left], n_agreeing[left] = turn, shift, agree
            fitted = agree >= 0
            left = left[fitted]
            placed = points @ R[left].transpose(0, 2, 1) + t[left][:, None]
            reach_m = max(reach_m / 2, self._tolerance_m)
        return R, t, n_agreeing


def _spacing_of(tree: cKDTree, positions: Floats) -> float:
    """Return the usual distance of landmarks (m, d), more where they stand in pairs."""
    from relmap.core.association.matching_kernels import PAIR_RATIO

    _, first, second = nearest(tree, positions, 3)[0].T
    return float(max(np.median(first), np.quantile(second, 0.25) / PAIR_RATIO))


def triangles(positions: Floats) -> tuple[Ints, Floats]:
    """Return triangles of neighbours as corners (k, 3), and their sides (k, 3), in metres.

    Sides are in ascending order, and each corner has the index of the opposite side.
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
    clear = np.diff(sides, axis=1).min(axis=1) > SLIM * sides[:, 2]
    return corners[clear], sides[clear]
