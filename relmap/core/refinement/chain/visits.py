"""Visits of landmarks: which observations of an id odometry and other landmarks confirm.

Odometry tells within a few iterations which observations of an id are of one landmark: they are a
visit. Two visits of an id are of one landmark if its distances to others are the same, as these do
not depend on where the robot is (paper, section II): ids may be swapped for a while.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.robust import limit_of
from relmap.core.refinement.chain.chain_data import Chain
from relmap.core.refinement.condensing import LENGTH
from relmap.core.state.table import NONE

COMPANY = 3 * LENGTH
"""Most iterations between observations of two landmarks whose distance is compared: with one or two
landmarks in view, few are seen sooner."""
NORMAL_MEDIAN = 0.6745
"""Median absolute deviation of the standard normal distribution."""
DIFFERS = 4.0
"""Standard deviations by which two distances differ if they are not of the same two landmarks."""
BLOCK = 4000
"""Observations whose pairs are held at a time."""


class Reckoned(NamedTuple):
    """Observations placed by odometry alone.

    `places` (n, d), metres; `variance` (n,): of an observed coordinate, square metres; `square`
    (n,): squared ranges; `part` (n,): part of the log without gaps in odometry; `way`, `turn` (n,):
    variances of odometry up to there, square metres and square radians.
    """

    places: Floats
    variance: Floats
    square: Floats
    part: Ints
    way: Floats
    turn: Floats

    def apart(self, a: Ints, b: Ints) -> Floats:
        """Return the distances (k,) of pairs of observations, metres."""
        return np.asarray(np.linalg.norm(self.places[a] - self.places[b], axis=1))

    def variance_between(self, a: Ints, b: Ints) -> Floats:
        """Return the variances (k,) of these distances; `b` (k,): the later observations."""
        turn = (self.turn[b] - self.turn[a]) * np.maximum(self.square[a], self.square[b])
        return np.asarray(self.variance[a] + self.variance[b] + self.way[b] - self.way[a] + turn)


class Distances(NamedTuple):
    """Distances between visits of different landmarks.

    `visits` (2, k); `of` (k,): the pair of landmarks; `metres`, `sd` (k,); `telling` (k,): fraction
    of the distances of all landmarks that differ from it.
    """

    visits: Ints
    of: Ints
    metres: Floats
    sd: Floats
    telling: Floats


def visits_of(chain: Chain, step_sd: tuple[Floats, Floats]) -> tuple[Ints, Bools]:
    """Return the visits of landmarks, and which observations have swapped ids.

    Observations of a landmark, at most `LENGTH` iterations apart, that show it where odometry
    expects it are one visit: wrong ids are seldom repeated. Where ids are swapped for a while,
    distances to other landmarks are not those of other visits.

    `step_sd`, tuple of (k - 1,): standard deviations of the distance and the turn of each step.
    Returns `visit` (n,): `NONE` for single observations; `is_swapped` (n,).
    """
    reckoned = _reckoned(chain, step_sd)
    visit = _visits(chain, reckoned)
    several = np.bincount(visit) > 1
    swapped = _contradicted(_distances(chain, reckoned, visit, several), len(several))
    return np.where(several[visit], visit, NONE), np.isin(visit, swapped)


def _reckoned(chain: Chain, step_sd: tuple[Floats, Floats]) -> Reckoned:
    (_, d), at = chain.points.shape, chain.iteration
    poses = np.tile(np.eye(4), (len(chain.motion) + 1, 1, 1))
    unknown = np.isnan(chain.motion[:, 0, 0])
    for k, step in enumerate(np.where(unknown[:, None, None], np.eye(4), chain.motion)):
        poses[k + 1] = poses[k] @ step
    places = np.einsum("nij,nj->ni", poses[at, :d, :d], chain.points) + poses[at, :d, 3]
    variance = d / np.maximum(np.sum(chain.root**2, axis=(1, 2)), 1e-300)
    sums = (unknown, *(np.where(unknown, 0.0, sd**2) for sd in step_sd))
    part, way, turn = (np.append(0, np.cumsum(each))[at] for each in sums)
    return Reckoned(places, variance, np.sum(chain.points**2, axis=1), part, way, turn)


def _visits(chain: Chain, reckoned: Reckoned) -> Ints:
    """Return the visit (n,) of each observation."""
    (n, d), at = chain.points.shape, chain.iteration
    order, pairs, off = np.lexsort((at, chain.landmark)), [], []
    for lag in range(1, LENGTH + 1):
        a, b = order[:-lag], order[lag:]
        near = (chain.landmark[a] == chain.landmark[b]) & (at[b] - at[a] <= LENGTH)
        near &= reckoned.part[a] == reckoned.part[b]
        a, b = a[near], b[near]
        pairs.append(np.column_stack([a, b]))
        off.append(reckoned.apart(a, b) / np.sqrt(reckoned.variance_between(a, b)))
    each, apart = np.concatenate(pairs), np.concatenate(off)
    first, second = each[apart <= limit_of(apart, d, 0.0)].T
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1])


def _distances(chain: Chain, reckoned: Reckoned, visit: Ints, several: Bools) -> Distances:
    """Return the distances between visits of several observations (v,), of different landmarks."""
    at, landmark = chain.iteration, chain.landmark
    own = np.flatnonzero(several[visit])
    own = own[np.argsort(at[own], kind="stable")]
    until = np.searchsorted(at[own], at[own] + COMPANY, side="right")
    # Short integers are sorted by radix.
    found, short = [np.empty((2, 0), int)], visit.astype(np.min_scalar_type(len(several)))
    for block in np.split(np.arange(len(own)), range(BLOCK, len(own), BLOCK)):
        times = until[block] - block - 1
        a, first = np.repeat(block, times), np.repeat(np.cumsum(times) - times, times)
        a, b = own[a], own[a + 1 + np.arange(len(a)) - first]
        differ = (landmark[a] != landmark[b]) & (reckoned.part[a] == reckoned.part[b])
        found.append(_best(np.stack([a, b])[:, differ], reckoned, short))
    best = _best(np.concatenate(found, axis=1), reckoned, short)
    _, of = np.unique(np.sort(landmark[best], axis=0), axis=1, return_inverse=True)
    variance, metres = reckoned.variance_between(*best), reckoned.apart(*best)
    usual = np.bincount(of, variance) / np.bincount(of)
    sd = np.sqrt(variance + usual[of])
    sd *= _noise(of, metres, sd)
    alike = _within(metres, DIFFERS * sd) / max(len(metres), 1)
    return Distances(visit[best], of, metres, sd, 1 - alike)


def _best(pairs: Ints, reckoned: Reckoned, visit: Ints) -> Ints:
    """Return of pairs (2, k), for each two visits, the observations that odometry relates best."""
    visits = np.sort(visit[pairs], axis=0)
    order = np.lexsort(visits)
    is_first = np.any(np.diff(visits[:, order], prepend=NONE), axis=0)
    variance, of = reckoned.variance_between(*pairs)[order], np.cumsum(is_first) - 1
    least = np.minimum.reduceat(variance, np.flatnonzero(is_first))
    own = np.flatnonzero(variance == least[of])
    return np.asarray(pairs[:, order[own[np.diff(of[own], prepend=NONE) > 0]]])


def _noise(of: Ints, metres: Floats, sd: Floats) -> float:
    """Return the noise of distances from the median one of their landmarks, as a factor of `sd`."""
    order = np.lexsort((metres, of))
    _, first, times = np.unique(of[order], return_index=True, return_counts=True)
    middle = order[first + (times - 1) // 2]
    off = np.delete(np.abs(metres - metres[middle][of]) / sd, middle)
    return float(np.median(off)) / NORMAL_MEDIAN if len(off) else 1.0


def _contradicted(distances: Distances, n: int) -> Ints:
    """Return the visits, of n, of which most distances differ from those of other visits.

    The worst one after another: its distances contradict those of right visits, too. Agreement
    counts as far as chance does not explain it.
    """
    visits, of, metres, sd, telling = distances
    left, again = np.ones(n, dtype=bool), np.ones(len(of), dtype=bool)
    differs, agrees = np.zeros((2, len(of)), dtype=bool)
    while True:
        differs[again], agrees[again] = _compared(of[again], metres[again], sd[again])
        against, support = (
            np.bincount(visits.ravel(), np.tile(weight, 2), n)
            for weight in (differs, agrees * telling)
        )
        worst = np.argmax(against - support)
        if against[worst] <= support[worst]:
            return np.flatnonzero(~left)
        left[worst] = False
        own = np.any(visits == worst, axis=0)
        differs[own] = agrees[own] = False
        again = np.isin(of, of[own]) & left[visits].all(axis=0)


def _compared(of: Ints, metres: Floats, sd: Floats) -> tuple[Bools, Bools]:
    """Return which distances (k,) most others of the same landmarks contradict, and support."""
    reach = DIFFERS * sd
    beside = 2 * np.max(metres + reach, initial=1.0)
    near, others = _within(of * beside + metres, reach) - 1, np.bincount(of)[of] - 1
    return 2 * near < others, (others > 0) & (2 * near >= others)


def _within(values: Floats, reach: Floats) -> Ints:
    """Return how many values (k,) are within the reach (k,) of each, itself included."""
    ordered = np.sort(values)
    end = np.searchsorted(ordered, values + reach, side="right")
    return np.asarray(end - np.searchsorted(ordered, values - reach))
