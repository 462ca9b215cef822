"""Static or dynamic: binning landmarks by the distances between them (section III, Fig. 12).

Two landmarks belong together when their mutual distance deviates no more than the noise explains.
The largest bin is the static one.  Following the paper, landmarks are compared with bins, each
represented by a few of its members; the search stops when half the landmarks are in one bin; and
bins are begun in the order of a priority queue.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.completion import RelativeMap
from relmap.core.growing import GrowingArray

LIMIT = 4.0
"""Variance that still counts as noise, in units of what the noise alone would give."""
FEWEST = 4
"""Common observations without which nothing is said."""
STRIKES = 2
"""Groups in a row that must see a landmark move: real observations have outliers."""
STILL = 60
"""Iterations at rest, and in view, after which a landmark that moved is static again."""
EXACT = 1e-9
"""Deviation, in units of the landmarks' distances, that is taken for rounding."""
SAMPLE = 12
"""Landmarks that a new bin must find company among, before all the others are asked."""


@dataclass(frozen=True, eq=False)
class Bins:
    """Sets of landmarks that keep their mutual distances.

    Attributes
    ----------
    members : list of (k,) int64
        Rows of the block, one array per bin, the largest bin first.
    n_comparisons : int
        Pairs of landmarks compared.
    """

    members: list[NDArray[np.int64]]
    n_comparisons: int

    @property
    def static(self) -> NDArray[np.int64]:
        """The largest bin."""
        return self.members[0] if self.members else np.empty(0, dtype=np.int64)


class DynamicStatus:
    """Which landmarks are known to move."""

    def __init__(self) -> None:
        self._dynamic: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        self._strikes: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._moved_until: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._tested_until: GrowingArray[np.int64] = GrowingArray(np.int64)

    @property
    def dynamic(self) -> NDArray[np.bool_]:
        """Whether each landmark was seen moving, and has not settled since; (n,)."""
        return self._dynamic.values

    def resize(self, n: int) -> None:
        """Make room for landmarks 0 to n - 1."""
        self._dynamic.resize(n, False)
        self._strikes.resize(n, 0)
        self._moved_until.resize(n, 0)
        self._tested_until.resize(n, 0)

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark be as dynamic as the new one that turned out to be it."""
        self.dynamic[old] = self.dynamic[new]
        self._strikes.values[old] = self._strikes.values[new]
        self._moved_until.values[old] = self._moved_until.values[new]
        self._tested_until.values[old] = self._tested_until.values[new]

    def test(self, relative: RelativeMap, noise_m: float) -> NDArray[np.bool_]:
        """Take note of who moves in a relative map; return who was seen often enough, and rests.

        A landmark whose place deviates more than the noise explains, in group after group, is
        dynamic; one that has been at rest for long is static again.
        """
        landmarks = relative.landmarks
        tested = relative.n_used >= FEWEST
        moves = tested & ~rests(relative, noise_m)
        self._strikes.values[landmarks[tested & ~moves]] = 0
        self._strikes.values[landmarks[moves]] += 1
        self.dynamic[landmarks[self._strikes.values[landmarks] >= STRIKES]] = True
        begin, end = int(relative.iterations[0]), int(relative.iterations[-1])
        out_of_sight = np.maximum(begin - 1 - self._tested_until.values[landmarks], 0)
        self._tested_until.values[landmarks] = end
        self._moved_until.values[landmarks] += out_of_sight
        self._moved_until.values[landmarks[moves]] = end
        settled = tested & ~moves & (end - self._moved_until.values[landmarks] > STILL)
        self.dynamic[landmarks[settled]] = False
        return np.asarray(tested & ~moves & ~self.dynamic[landmarks])


def rests(relative: RelativeMap, noise_m: float) -> NDArray[np.bool_]:
    """Tell whose place deviates no more than the noise explains; (n,)."""
    limit = LIMIT * max(noise_m, _exact(relative.positions)) ** 2
    return np.asarray(np.nan_to_num(relative.variance) <= limit * relative.amplified)


class Binning:
    """Sorts the landmarks of one block into bins.

    Parameters
    ----------
    block : (n, i, d) float64, robot frame, metres
        NaN where a landmark was not seen.
    noise_m : float
        Standard deviation of an observed coordinate.
    """

    def __init__(self, block: NDArray[np.float64], noise_m: float) -> None:
        self._block = block
        self._seen = np.isfinite(block[:, :, 0])
        centred = block[self._seen]
        self._limit = LIMIT * 2 * max(noise_m, _exact(centred)) ** 2
        self._n_comparisons = 0

    def sort(self, priority: NDArray[np.float64]) -> Bins:
        """Sort landmarks into bins; after n log2 n comparisons none is begun any more.

        Landmarks seen too seldom to be compared are in none.

        Parameters
        ----------
        priority : (n,) float64
            Bins are begun with the landmarks of the highest priority.
        """
        rest = self._seen.sum(axis=1) >= FEWEST
        n = int(rest.sum())
        allowed = n * np.log2(max(n, 2))
        queue = [(-priority[row], row) for row in np.flatnonzero(rest).tolist()]
        heapq.heapify(queue)
        bins: list[NDArray[np.int64]] = []
        while queue and self._n_comparisons < allowed:
            _, pivot = heapq.heappop(queue)
            if not rest[pivot]:
                continue
            rest[pivot] = False
            members = self._begun_with(pivot, np.flatnonzero(rest))
            rest[members] = False
            bins.append(members)
            if 2 * len(members) >= n:
                break
        bins.sort(key=len, reverse=True)
        return Bins(bins, self._n_comparisons)

    def _begun_with(self, pivot: int, rest: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the members of the bin that begins with the pivot."""
        alone = np.array([pivot])
        if len(rest) > 2 * SAMPLE:
            sample = rest[:: len(rest) // SAMPLE]
            if not self._agree(pivot, sample).any():
                return alone
        near = rest[self._agree(pivot, rest)]
        if len(near) < 2:
            return np.concatenate([alone, near])
        # Three more members, from the outermost to the innermost, catch what circles round the
        # pivot; nobody votes for himself.
        place = np.nanmean(self._block[near], axis=1)
        outward = np.argsort(_spread(place, place.mean(axis=0)), kind="stable")
        voters = np.unique(outward[[0, len(near) // 2, -1]])
        votes = np.sum([self._agree(near[voter], near) for voter in voters], axis=0)
        self._n_comparisons -= len(voters)  # those of voters with themselves
        others = len(voters) - np.isin(np.arange(len(near)), voters)
        return np.concatenate([alone, near[2 * (votes - len(voters) + others) >= others]])

    def _agree(self, row: int, others: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell with which others (k,) the landmark keeps its distance, but for the noise."""
        self._n_comparisons += len(others)
        common = self._seen[others] & self._seen[row]
        apart = np.where(common[:, :, None], self._block[others] - self._block[row], 0.0)
        distance = np.sqrt(np.einsum("kid,kid->ki", apart, apart))
        n = np.maximum(common.sum(axis=1), 1)
        mean = distance.sum(axis=1) / n
        deviation = np.where(common, distance - mean[:, None], 0.0)
        variance = np.einsum("ki,ki->k", deviation, deviation) / np.maximum(n - 1, 1)
        return np.asarray((n >= FEWEST) & (variance <= self._limit))


def _spread(points: NDArray[np.float64], centre: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sum((points - centre) ** 2, axis=1))


def _exact(points: NDArray[np.float64]) -> float:
    """Return the deviation, metres, that rounding alone may bring to points (n, d)."""
    return EXACT * float(np.sqrt(np.mean(points**2)))
