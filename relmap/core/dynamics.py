"""Static or dynamic: binning landmarks by the distances between them (section III, Fig. 12).

Two landmarks belong together when their mutual distance deviates no more than the noise explains.
The largest bin is the static one.  Following the paper, landmarks are compared with bins, each
represented by a few of its members; the search stops when half the landmarks are in one bin; and
bins are begun in the order of a priority queue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.completion import RelativeMap
from relmap.core.growing import GrowingArray

LIMIT = 4.0
"""Variance that still counts as noise, in units of what the noise alone would give."""
FEWEST = 4
"""Common observations without which nothing is said."""
ENOUGH = 8
"""Observations that tell one who moves from one who was seen badly now and then."""
STRIKES = 2
"""Groups in a row, each with observations of its own, that must see a landmark move."""
STILL = 60
"""Iterations at rest, and in view, after which a landmark that moved is static again."""
ALONE = -1
"""In place of a moving bin: the landmark moves on its own, or not at all."""
EXACT = 1e-9
"""Deviation, in units of the landmarks' distances, that is taken for rounding."""
SAMPLE = 6
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
        self._restless: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        self._struck_until: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._moved_until: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._tested_until: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._moving_bin: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._n_bins = 0

    @property
    def dynamic(self) -> NDArray[np.bool_]:
        """Whether each landmark was seen moving, and has not settled since; (n,)."""
        return self._dynamic.values

    @property
    def moving_bin(self) -> NDArray[np.int64]:
        """Bin of each dynamic landmark that moves together with others, or `ALONE`; (n,).

        Bins are numbered in the order in which they were first told apart.
        """
        return self._moving_bin.values

    def go_together(self, bins: list[NDArray[np.int64]], alone: NDArray[np.int64]) -> None:
        """Take note of which dynamic landmarks kept their mutual distances, and which went alone.

        A bin keeps its number as long as some of it stay together; who is alone in view keeps it.
        """
        compared = self.moving_bin[np.concatenate([alone, *bins])]
        with_others = np.array([np.sum(compared == n) > 1 for n in self.moving_bin[alone]], bool)
        self.moving_bin[alone[with_others]] = ALONE
        taken = {ALONE}
        for members in bins:
            known = set(self.moving_bin[members].tolist()) - taken
            number = min(known, default=self._n_bins)
            self._n_bins = max(self._n_bins, number + 1)
            self.moving_bin[members] = number
            taken.add(number)

    def judge_at_last(self, landmarks: NDArray[np.int64]) -> None:
        """Call those dynamic that left the view without a place and moved when last looked at."""
        self.dynamic[landmarks[self._restless.values[landmarks]]] = True

    def resize(self, n: int) -> None:
        """Make room for landmarks 0 to n - 1."""
        self._dynamic.resize(n, False)
        self._strikes.resize(n, 0)
        self._restless.resize(n, False)
        self._struck_until.resize(n, -1)
        self._moved_until.resize(n, 0)
        self._tested_until.resize(n, 0)
        self._moving_bin.resize(n, ALONE)

    def merge(self, new: int, old: int) -> None:
        """Let an old landmark be as dynamic as the new one that turned out to be it."""
        self.dynamic[old] = self.dynamic[new]
        self._strikes.values[old] = self._strikes.values[new]
        self._restless.values[old] = self._restless.values[new]
        self._struck_until.values[old] = self._struck_until.values[new]
        self._moved_until.values[old] = self._moved_until.values[new]
        self._tested_until.values[old] = self._tested_until.values[new]
        self._moving_bin.values[old] = self._moving_bin.values[new]

    def test(self, relative: RelativeMap, noise_m: float) -> NDArray[np.bool_]:
        """Take note of who moves in a relative map; return who was seen often enough, and rests.

        A landmark whose place deviates more than the noise explains, in group after group, is
        dynamic; one that has been at rest for long is static again.
        """
        landmarks = relative.landmarks
        still = rests(relative, noise_m)
        self._restless.values[landmarks] = ~still & (relative.n_used >= FEWEST)
        tested = relative.n_used >= ENOUGH
        moves = tested & ~still
        # Neither way does it count twice what was seen by the last group that saw it move.
        later = relative.iterations > self._struck_until.values[landmarks][:, None]
        fresh = np.sum(relative.used & later, axis=1) >= FEWEST
        struck = moves & fresh
        self._strikes.values[landmarks[tested & ~moves & fresh]] = 0
        self._strikes.values[landmarks[struck]] += 1
        self._struck_until.values[landmarks[struck]] = relative.iterations[-1]
        self.dynamic[landmarks[self._strikes.values[landmarks] >= STRIKES]] = True
        begin = relative.iterations[np.argmax(relative.used, axis=1)]
        end = relative.iterations[-1 - np.argmax(relative.used[:, ::-1], axis=1)]
        out_of_sight = np.maximum(begin - 1 - self._tested_until.values[landmarks], 0)
        self._tested_until.values[landmarks] = np.maximum(self._tested_until.values[landmarks], end)
        self._moved_until.values[landmarks] += out_of_sight
        self._moved_until.values[landmarks[moves]] = end[moves]
        settled = tested & ~moves & (end - self._moved_until.values[landmarks] > STILL)
        self.dynamic[landmarks[settled]] = False
        self.moving_bin[landmarks[settled]] = ALONE
        return np.asarray((relative.n_used >= FEWEST) & still & ~self.dynamic[landmarks])


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
        self._often = np.isfinite(block[:, :, 0]).sum(axis=1) >= FEWEST
        self._limit = LIMIT * 2 * max(noise_m, _exact(block)) ** 2

    def sort(self, priority: NDArray[np.float64], allowed: float | None = None) -> Bins:
        """Sort landmarks into bins, until half of them, or of the priority, are in one.

        Landmarks seen too seldom to be compared, or that found no company, are in none.

        Parameters
        ----------
        priority : (n,) float64
            Bins are begun with the landmarks of the highest priority.
        allowed : float, optional
            Most comparisons; n log2 n, of the n seen often enough, where left out.
        """
        from relmap.core.kernels.binning import sort_into_bins

        if allowed is None:
            allowed = n_log_n(int(self._often.sum()))
        bin_of, n_comparisons = sort_into_bins(
            self._block, self._often.copy(), priority, self._limit, FEWEST, SAMPLE, int(allowed)
        )
        sizes = np.bincount(bin_of[bin_of >= 0])
        bins = np.argsort(-sizes, kind="stable")
        return Bins([np.flatnonzero(bin_of == number) for number in bins], n_comparisons)


def n_log_n(n: int) -> float:
    """Return n log2 n, the most comparisons that may be made among n landmarks."""
    return float(n * np.log2(max(n, 2)))


def _exact(points: NDArray[np.float64]) -> float:
    """Return the deviation, metres, that rounding alone may bring to points (n, ..., d)."""
    return EXACT * float(np.sqrt(points.shape[-1]) * np.nanmax(np.abs(points), initial=0.0))
