"""Loops that few landmarks close: sets of landmarks mapped twice, by the covariance of a map.

Where few landmarks are in view, too few of a neighbourhood are found again for it to be recognised
as a place. But a refined map bounds its drift. Pairs of landmarks that are the same are jointly
compatible with the covariance of their differences (Neira and Tardos, 2001): what is common to all
may be large, as the drift is, the rest is small. The volume of what is compatible gives the
expected number of sets of random landmarks that would be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri, gammaln

from relmap.core.arrays import Floats, Ints, evenly
from relmap.core.association.base import median_apart
from relmap.core.association.placement import consistent_placements
from relmap.core.association.reobservation.recognition import BY_CHANCE, CLEAR, SIGMAS
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.association.scale import spacing_of
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined
from relmap.core.scan import TINY
from relmap.core.state.table import NONE, LandmarkState

FEWEST = 3
"""Landmarks that tie parts; in the plane their motion leaves three of six coordinates."""
PAIR = 2
"""Landmarks that close a loop within a submap, whose covariance bounds the motion, too."""
SPACINGS = 2.0
"""Largest distance of landmarks that may be one, in spacings: rivals along a pattern are nearer."""
RARE = 1e-3
"""Accepted probability that landmarks mapped twice are not compatible."""
LEAST = 1e-9
"""Variance of a coordinate at least, relative to that of an observation."""
SAMPLE = 2000
"""Number of pairs of landmarks near each other of which those never seen together are counted."""
SETS = 4
"""Number of sets of pairs that are compared, the largest first."""


class Doubled:
    """Finds sets of landmarks of a refined submap that are mapped twice.

    `refined`: the submap; its `spread` has the covariances of landmarks that are kept unknowns.
    `rows`: of all iterations.
    """

    def __init__(self, refined: Refined, table: LandmarkState, rows: SegmentRows) -> None:
        self._at, self._d = refined.positions, refined.positions.shape[1]
        self._refined, self._m = refined, len(refined.landmarks)
        self._number = np.full(len(table), NONE)
        self._number[refined.landmarks] = np.arange(self._m)
        self._row = self._number[table.now(rows.landmark)]
        self._rows, self._sightings = rows, Sightings(rows, table)
        sd_m = np.sqrt(np.trace(refined.covariances, axis1=1, axis2=2))
        self._reach_m = SIGMAS * np.where(np.isfinite(sd_m), sd_m, 0.0)
        spacing_m = max(median_apart(cKDTree(self._at)), TINY)
        self._log_density = math.log(math.log(2)) - log_volume(self._d, spacing_m)

    def sets(self) -> list[Ints]:
        """Return sets of pairs (k, 2), unlikely by chance, without rival and common landmarks."""
        # Where many landmarks are in view the unknowns are placements.
        has_few = self._refined.has_joint_covariances and self._m >= 2 * FEWEST
        if not has_few or self._refined.is_exact:
            return []
        pairs, log_share = self._candidates()
        found = [
            match for of in self._by_segment(pairs) for match in self._compatible(*of, log_share)
        ]
        chosen, taken = [], np.zeros(self._m, dtype=bool)
        for _, rows in sorted(found, key=lambda match: match[0]):
            if not taken[rows].any():
                taken[rows] = True
                chosen.append(self._refined.landmarks[rows])
        return chosen

    def _candidates(self) -> tuple[Ints, float]:
        """Return pairs (p, 2) of rows within the drift that no scan shows together, both ways.

        Also the log of the share of the landmarks near each other that no scan shows together.
        """
        most_m = SPACINGS * spacing_of(self._at)
        every = cKDTree(self._at).query_pairs(most_m, output_type="ndarray").reshape(-1, 2)
        apart = np.linalg.norm(self._at[every[:, 0]] - self._at[every[:, 1]], axis=1)
        pairs = every[apart <= self._reach_m[every].sum(axis=1)]
        if len(pairs) < PAIR:
            return np.empty((0, 2), dtype=np.int64), 0.0
        pairs = self._number[self._sightings.apart(self._refined.landmarks[pairs])]
        tried = self._refined.landmarks[every[evenly(len(every), SAMPLE)]]
        log_share = math.log((1 + len(self._sightings.apart(tried))) / (1 + len(tried)))
        return np.concatenate([pairs, pairs[:, ::-1]]), log_share

    def _by_segment(self, pairs: Ints) -> Iterator[tuple[int, Ints]]:
        """Yield for segments how many landmarks they show, and the pairs (k, 2) of these.

        Only if they show the first one of enough pairs; each set of pairs once.
        """
        order = np.argsort(pairs[:, 0], kind="stable")
        pairs, had = pairs[order], set[bytes]()
        begin = np.searchsorted(pairs[:, 0], np.arange(self._m + 1))
        own = self._row != NONE
        segment, row = self._rows.segment[own], self._row[own]
        first = np.searchsorted(segment, np.arange(self._rows.n_segments + 1))
        for k in range(self._rows.n_segments):
            shown = np.unique(row[first[k] : first[k + 1]])
            paired = shown[begin[shown + 1] > begin[shown]]
            if len(paired) >= PAIR and paired.tobytes() not in had:
                had.add(paired.tobytes())
                of = [np.arange(begin[one], begin[one + 1]) for one in paired.tolist()]
                yield len(shown), pairs[np.concatenate(of)]

    def _compatible(self, n: int, pairs: Ints, log_share: float) -> Iterator[tuple[float, Ints]]:
        """Yield the largest compatible set among pairs (k, 2) of n landmarks seen together.

        With the log of the chance of as many random ones, which `log_share` of are never seen
        together: once, as those of one set are hidden together.
        """
        off, noise_m = self._at[pairs[:, 0]] - self._at[pairs[:, 1]], self._refined.noise_m
        spread = differences(self._refined, pairs) + LEAST * noise_m**2 * np.eye(off.size)
        each = np.arange(off.size).reshape(off.shape)
        own = spread[each[:, :, None], each[:, None]]
        near = np.sum(off * np.linalg.solve(own, off[:, :, None])[:, :, 0], axis=1)
        kept = np.flatnonzero(near <= chdtri(self._d, RARE))
        pairs, off, each = pairs[kept], off[kept], each[kept]

        def log_chance(of: Ints) -> float:
            own = spread[np.ix_(*2 * (each[of].ravel(),))]
            return log_share + self._log_chance(n, off[of], own)

        found: list[tuple[int, float, Ints]] = []
        tolerance_m = SIGMAS * noise_m
        for placement, matches in consistent_placements(self._at, self._at, pairs, tolerance_m):
            if len(matches) < PAIR or len(found) == SETS:
                break
            here, there = (self._at[of] for of in pairs.T)
            apart_m = np.linalg.norm(placement.apply(here) - there, axis=1)
            chance, of = _likeliest(pairs, apart_m, tolerance_m, log_chance)
            if chance < np.inf:
                found.append((-len(of), chance, pairs[of]))
        found.sort(key=lambda one: one[0])
        n_rival, n_best = (-found[k][0] if len(found) > k else 0 for k in (1, 0))
        is_clear = n_rival < min(FEWEST, n_best) or n_rival <= CLEAR * n_best
        if found and found[0][1] <= math.log(BY_CHANCE) and is_clear:
            yield found[0][1:]

    def _log_chance(self, n: int, off: Floats, spread: Floats) -> float:
        """Return the log of the expected number of as compatible sets of random landmarks.

        Infinite if the differences (k, d) are not compatible with their covariance (k d, k d).
        """
        square = float(off.ravel() @ np.linalg.solve(spread, off.ravel()))
        if square > chdtri(off.size, RARE):
            return np.inf
        k = len(off)
        ways = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
        volume = log_volume(off.size, math.sqrt(max(square, off.size)))
        volume += np.linalg.slogdet(spread)[1] / 2
        return float(math.log(self._rows.n_segments) + ways + volume + k * self._log_density)


def differences(refined: Refined, pairs: Ints) -> Floats:
    """Return the covariance (k d, k d) of the differences of pairs (k, 2) of landmarks."""
    (m, d), k, each = refined.positions.shape, len(pairs), np.arange(len(pairs))
    columns = np.zeros((m, d, k, d))
    columns[pairs[:, 0], :, each] += np.eye(d)
    columns[pairs[:, 1], :, each] -= np.eye(d)
    found = refined.spread.times(columns.reshape(m, d, k * d))
    return np.asarray((found[pairs[:, 0]] - found[pairs[:, 1]]).reshape(k * d, k * d))


def _likeliest(
    pairs: Ints, apart_m: Floats, tolerance_m: float, log_chance: Callable[[Ints], float]
) -> tuple[float, Ints]:
    """Return the log of the chance, and the rows (s,), of the set of pairs (k, 2) with the least.

    Built up from those nearest to each other, at `apart_m` (k,), each landmark once.
    """
    chosen, least, taken = list[int](), np.inf, set[int]()
    for row in np.argsort(apart_m, kind="stable")[: np.sum(apart_m <= tolerance_m)].tolist():
        if not taken.isdisjoint(pairs[row].tolist()):
            continue
        of = np.array([*chosen, row])
        chance = log_chance(of) if len(of) >= PAIR else np.inf
        if len(of) <= PAIR or chance < least:
            chosen, least = of.tolist(), chance
            taken.update(pairs[row].tolist())
    return least, np.sort(np.array(chosen, dtype=np.int64))


def log_volume(n: int, radius: float) -> float:
    """Return the log of the volume of a ball in n dimensions."""
    return float(n / 2 * math.log(math.pi) - gammaln(n / 2 + 1) + n * math.log(radius))
