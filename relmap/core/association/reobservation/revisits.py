"""Revisited places in a map that depends on odometry, searched within the bounds of its drift.

Few landmarks are in view at once, some seen once or twice, so triangles of neighbours find nothing.
All landmarks of one stretch of the run are compared with the rest of the map. The covariance of the
chain of poses bounds the drift between them. The placement with the most matches is accepted if so
many are unlikely by chance and it has no rival.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import bdtrc

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import median_apart, nearest
from relmap.core.association.placement import Placement, consistent_placements
from relmap.core.association.reobservation.coinciding import TOLERANCE, neighbours_fit
from relmap.core.association.reobservation.recognition import BY_CHANCE, CLEAR
from relmap.core.association.search import matches_of, settled
from relmap.core.motion_noise import FLOOR_M
from relmap.core.refinement.chain.drift import Drift
from relmap.core.refinement.condensing import LENGTH
from relmap.core.state.table import NONE, LandmarkState

SOLID = 3
"""Minimum number of observations of a landmark that is compared."""
FEWEST = 5
"""Minimum number of matches of a revisit."""
MOST = 40
"""Maximum number of landmarks of a stretch, those with the least variance from its end."""
FARTHEST = 1.5, 4.0, 12.0
"""Largest drift, in standard deviations: each is tried if nothing is found within the one before.
Errors of real sensors are correlated over time, so chains drift farther than with independent
errors.  Rivals are searched for within the next one: a lattice has them farther away."""
STRAINED, COMPARED = 2.0, 12
"""Largest strain of a revisit with much drift (see `Drift.strain`), and number of its matches from
which it is computed: correlated errors of odometry hardly exceed its noise; to take another place
for this one, a few steps must have large errors."""
NEIGHBOUR, USUAL = 4, 3.67
"""Rank of the neighbour whose distance gives the density of the landmarks, and their number within
the median of this distance (of a gamma distribution).  Nearer ones may be the same landmark, mapped
twice."""
WIDER = 2.0
"""Factor on that distance before the map is refined with the matches."""
MOST_PAIRS = 800
"""Maximum number of candidate matches in space, the nearest."""
FINE = 4.0
"""Distinguishable placements per shift by the tolerance."""
STRIDE = 2 * LENGTH
"""Iterations from one stretch to the next."""
LOCAL = 0.5
"""Largest standard deviation of the landmarks of a stretch from its end, in tolerances."""
AT_ONCE = 8
"""Poses whose covariances with all landmarks are computed at once."""
PEAKS = 12
"""Number of placements that are fitted, those with the most votes."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """The landmarks of one stretch of a run, and their candidates.

    `new` (n,), `old` (m,): landmarks; `points` (n, d), `there` (m, d), metres: their positions in
    the frame of the pose; `reach_m` (m,): largest error of the position of each older one; `sd_m`
    (m,): its standard deviation; `turn_rad`: largest error of their direction.
    """

    new: Ints
    old: Ints
    points: Floats
    there: Floats
    reach_m: Floats
    sd_m: Floats
    turn_rad: float

    def pairs(self, matches: Ints) -> Ints:
        """Return the landmarks (k, 2) of matches (k, 2)."""
        return np.column_stack([self.new[matches[:, 0]], self.old[matches[:, 1]]])


@dataclass(frozen=True, eq=False)
class Revisit:
    """A place that was seen twice.

    `pairs` (k, 2): landmarks of one visit, and the same ones of the other; `chance`: expected
    number of revisits with as many matches by chance, over the whole map; `surprise`: drift of the
    map, in standard deviations.
    """

    pairs: Ints
    chance: float
    surprise: float


class RevisitFinder:
    """Finds revisited places in one part of a map.

    `landmarks` (m,): those of the part, `NONE` if another's; `noise_m`: standard deviation of an
    observed coordinate.

    Attributes: `alike`: landmarks of places that look the same but that odometry tells apart.
    """

    def __init__(self, table: LandmarkState, landmarks: Ints, drift: Drift, noise_m: float) -> None:
        self.alike: set[int] = set()
        self._table, self._landmarks, self._drift = table, landmarks, drift
        self._seen_from: dict[int, tuple[Floats, Floats]] = {}
        n_poses = len(drift.state.t)
        self._poses = np.minimum(np.arange(STRIDE, n_poses + STRIDE - 1, STRIDE), n_poses - 1)
        self._tolerance_m = WIDER * TOLERANCE * max(noise_m, FLOOR_M * drift.unit)
        own = table.observations[landmarks] >= SOLID
        own &= (table.submap[landmarks] != NONE) & (table.now(landmarks) == landmarks)
        own &= landmarks != NONE
        self._own = np.flatnonzero(own)
        at = drift.state.positions[self._own]
        self._apart_m = median_apart(cKDTree(at), NEIGHBOUR) if len(at) else np.inf

    def revisits(self) -> list[Revisit]:
        """Return the revisits that are new, the most certain first, without conflicts."""
        for farthest in pairwise((*FARTHEST, FARTHEST[-1])):
            found = self._within(*farthest)
            if found:
                return found
        return []

    def _within(self, sigmas: float, wider: float) -> list[Revisit]:
        """Return those with a drift of at most `sigmas` standard deviations, without rivals."""
        each = [self._revisit(pose, sigmas, wider) for pose in self._poses.tolist()]
        found = [revisit for revisit in each if revisit is not None]
        sure, taken = [], np.full(len(self._table), NONE)
        for revisit in sorted(found, key=lambda revisit: revisit.chance):
            new, old = revisit.pairs.T
            if ((taken[new] == NONE) | (taken[new] == old)).all():
                taken[new] = old
                sure.append(revisit)
        return sure

    def _from(self, pose: int) -> tuple[Floats, Floats]:
        """Return the standard deviations (m,) of landmarks and directions from a pose.

        Those from the next poses are computed with them, which takes a fraction of the time.
        """
        if pose not in self._seen_from:
            first = int(np.searchsorted(self._poses, pose))
            poses = self._poses[first : first + AT_ONCE]
            each = zip(*self._drift.from_poses(poses), strict=True)
            self._seen_from |= dict(zip(poses.tolist(), each, strict=True))
        return self._seen_from[pose]

    def _stretch(self, pose: int, sigmas: float) -> Stretch | None:
        """Return the stretch that ends at a pose; None if there is too little to compare."""
        drift = self._drift
        sd_m, turn = self._from(pose)
        near = self._own[sd_m[self._own] <= LOCAL * self._tolerance_m]
        new = near[np.argsort(sd_m[near], kind="stable")[:MOST]]
        old = self._own[sd_m[self._own] > self._tolerance_m]
        if len(new) < FEWEST or len(old) < FEWEST:
            return None
        R, t = drift.state.R[pose], drift.state.t[pose]
        points, there = ((drift.state.positions[of] - t) @ R for of in (new, old))
        reach = sigmas * sd_m[old] + self._tolerance_m
        extent_m = np.linalg.norm(points, axis=1).max()
        near = np.linalg.norm(there, axis=1) <= reach + extent_m
        if near.sum() < FEWEST:
            return None
        old, there = old[near], there[near]
        turn_rad = float(sigmas * turn[old].max())
        return Stretch(new, old, points, there, reach[near], sd_m[old], turn_rad)

    def _revisit(self, pose: int, sigmas: float, wider: float) -> Revisit | None:
        """Return the revisit of a stretch; None if there is none, or it is uncertain."""
        stretch = self._stretch(pose, sigmas)
        places = _places(stretch, self._tolerance_m) if stretch is not None else []
        if stretch is None or not places or len(places[0][1]) < FEWEST:
            return None
        placement, matches = places[0]
        chance = self._chance(stretch, placement, matches)
        rival = max((_elsewhere(other, matches) for _, other in places[1:]), default=0)
        if chance > BY_CHANCE or rival > CLEAR * len(matches):
            return None
        if wider > sigmas and self._has_rival(pose, wider, stretch.pairs(matches), chance):
            return None
        here, there = placement.apply(stretch.points[matches[:, 0]]), stretch.there[matches[:, 1]]
        reach_m, tolerance_m = float(stretch.reach_m.max()), self._tolerance_m / WIDER
        if neighbours_fit(here, there, stretch.there, reach_m, tolerance_m):
            return None  # the place is periodic
        off_m = np.linalg.norm(here - there, axis=1)
        # Some of the others may be matched to a neighbour; they are merged once the map is solved.
        new, old = matches[off_m <= max(np.median(off_m), tolerance_m)].T
        middle = stretch.points[new].mean(axis=0)
        drifted_m = float(np.linalg.norm(placement.apply(middle) - middle))
        own = stretch.pairs(np.column_stack([new, old]))
        pairs = self._landmarks[own]
        if sigmas > FARTHEST[0] and self._is_strained(own):
            self.alike.update(pairs.ravel().tolist())
            return None
        return Revisit(pairs, chance, drifted_m / float(np.median(stretch.sd_m[old])))

    def _is_strained(self, pairs: Ints) -> bool:
        """Return whether landmarks (k, 2) can only be the same if steps of odometry are wrong."""
        pairs = pairs[:: -(-len(pairs) // COMPARED)]
        off = self._drift.state.positions[pairs]
        noise_m = self._tolerance_m / (WIDER * TOLERANCE)
        unknowns = self._drift.unknown[pairs]
        return self._drift.strain(unknowns, off[:, 0] - off[:, 1], noise_m) > STRAINED

    def _has_rival(self, pose: int, sigmas: float, pairs: Ints, chance: float) -> bool:
        """Return whether other matches than these (k, 2) are nearly as many and as unlikely."""
        stretch = self._stretch(pose, sigmas)
        return stretch is not None and any(
            _elsewhere(stretch.pairs(matches), pairs) > CLEAR * len(pairs)
            and self._chance(stretch, placement, matches) <= chance**CLEAR
            for placement, matches in _places(stretch, self._tolerance_m)
        )

    def _chance(self, stretch: Stretch, placement: Placement, matches: Ints) -> float:
        """Return the expected number of placements with as many matches by chance, in the map.

        There may be many matches within the tolerance, or fewer within a smaller one. The number of
        placements is that of those distinguishable within the drift.  Only landmarks near older
        ones can match.
        """
        n, d = stretch.points.shape
        nearest_m = nearest(cKDTree(stretch.there), placement.apply(stretch.points))[0][:, 0]
        overlapping = int(np.sum(nearest_m <= max(self._apart_m, self._tolerance_m)))
        extent_m = float(np.linalg.norm(stretch.points - stretch.points.mean(0), axis=1).max())
        here, there = stretch.points[matches[:, 0]], stretch.there[matches[:, 1]]
        off_m = np.linalg.norm(placement.apply(here) - there, axis=1)
        reach_m, turned_m = stretch.reach_m.max(), min(stretch.turn_rad, np.pi) * extent_m
        chance = []
        for tolerance_m in (self._tolerance_m, self._tolerance_m / WIDER):
            # Half of the landmarks have this many others within `apart_m`.
            share = min(0.5, USUAL * (tolerance_m / self._apart_m) ** d)
            trials = max(1.0, FINE * reach_m / tolerance_m) ** d
            trials *= max(1.0, FINE * turned_m / tolerance_m) ** (2 * d - 3)
            trials *= max(1.0, len(self._own) / n)
            agreeing = int(np.sum(off_m <= tolerance_m))
            chance.append(trials * float(bdtrc(agreeing - 1, overlapping, share)))
        return float(len(chance) * min(chance))


def _places(stretch: Stretch, tolerance_m: float) -> list[tuple[Placement, Ints]]:
    """Return placements on the older landmarks, the best first, each with its matches (k, 2)."""
    points, there = stretch.points, stretch.there
    if points.shape[1] == 3:
        apart = np.linalg.norm(points[:, None] - there[None], axis=2)
        order = np.argsort(apart, axis=None, kind="stable")[:MOST_PAIRS]
        pairs = np.column_stack(np.unravel_index(order, apart.shape))
        pairs = pairs[apart[pairs[:, 0], pairs[:, 1]] <= stretch.reach_m[pairs[:, 1]]]
        every = consistent_placements(points, there, pairs, tolerance_m)
        return list(islice(every, 2))
    found: list[tuple[Placement, Ints]] = []
    for guess in _voted(stretch, tolerance_m):
        placement = settled(points, there, guess, tolerance_m)
        if placement is None:
            continue
        match = matches_of(points, there, placement, tolerance_m)
        of = np.flatnonzero(match >= 0)
        matches: Ints = np.column_stack([of, match[of]])
        if not any(_elsewhere(matches, other) == 0 for _, other in found):
            found.append((placement, matches))
    found.sort(key=lambda place: -len(place[1]))
    return found


def _elsewhere(matches: Ints, others: Ints) -> int:
    """Return how many of some matches (k, 2) are not among others."""
    return len(matches) - len({*map(tuple, matches.tolist())} & {*map(tuple, others.tolist())})


def _voted(stretch: Stretch, tolerance_m: float) -> Iterator[Placement]:
    """Yield the placements in the plane that most pairs of landmarks vote for (Ballard, 1981)."""
    from relmap.core.association.reobservation.voting_kernels import most_voted

    middle = stretch.points.mean(axis=0)
    points, there = stretch.points - middle, stretch.there - middle
    extent_m = float(np.linalg.norm(points, axis=1).max())
    most, step = min(stretch.turn_rad, np.pi), 2 * tolerance_m / extent_m
    angles = np.linspace(-most, most, 1 + 2 * int(np.ceil(most / step)))
    votes, shifts = most_voted(points, there, stretch.reach_m, angles, 2 * tolerance_m)
    for peak in np.argsort(-votes, axis=None, kind="stable")[:PEAKS].tolist():
        cos, sin = np.cos(angles[peak // 2]), np.sin(angles[peak // 2])
        R = np.array([[cos, -sin], [sin, cos]])
        yield Placement(R, shifts[peak // 2, peak % 2] + middle - R @ middle, 0)
