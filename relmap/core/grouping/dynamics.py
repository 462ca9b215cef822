"""Static or dynamic: binning landmarks by their mutual distances (section III, Fig. 12).

Two landmarks belong to the same bin if their mutual distance varies no more than noise explains.
The largest bin is the static one.  Following the paper, landmarks are compared with bins, each
represented by a few of its members; the search stops when half the landmarks are in one bin; and
bins are started in the order of a priority queue.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.grouping.completion import RelativeMap
from relmap.core.state.table import NONE, LandmarkState

LIMIT = 4.0
"""Variance that still counts as noise, relative to the variance of noise alone."""
FEWEST = 4
"""Minimum number of common observations to compare two landmarks."""
ENOUGH = 8
"""Observations that distinguish a moving landmark from one with occasional outliers."""
STRIKES = 2
"""Consecutive groups, each with new observations, that must see a landmark move."""
STILL = 60
"""Iterations at rest and in view after which a dynamic landmark is static again."""
EXACT = 1e-9
"""Deviation, relative to the landmarks' distances, treated as rounding."""
SAMPLE = 6
"""Sample of landmarks among which a new bin must find a member before all others are tried."""


@dataclass(frozen=True, eq=False)
class Bins:
    """Sets of landmarks that keep their mutual distances.

    `members`, list of (k,): rows of the block, one array per bin, largest bin first;
    `n_comparisons`: pairs of landmarks compared.
    """

    members: list[Ints]
    n_comparisons: int

    @property
    def static(self) -> Ints:
        """The largest bin."""
        return self.members[0] if self.members else np.empty(0, dtype=np.int64)


class DynamicStatus:
    """Tracks which landmarks are moving."""

    STATE = "_n_bins"

    def __init__(self, table: LandmarkState) -> None:
        self.table = table
        self._n_bins = 0

    def go_together(self, bins: list[Ints], alone: Ints) -> None:
        """Record which dynamic landmarks kept their mutual distances, and which moved alone.

        A bin keeps its number as long as some members stay together; a member alone in view keeps
        it.
        """
        table = self.table
        compared = table.moving_bin[np.concatenate([alone, *bins])]
        with_others = np.array([np.sum(compared == n) > 1 for n in table.moving_bin[alone]], bool)
        table.moving_bin[alone[with_others]] = NONE
        taken = {NONE}
        for members in bins:
            known = set(table.moving_bin[members].tolist()) - taken
            number = min(known, default=self._n_bins)
            self._n_bins = max(self._n_bins, number + 1)
            table.moving_bin[members] = number
            taken.add(number)

    def test(self, relative: RelativeMap, noise_m: float) -> Bools:
        """Update which landmarks move by a relative map; return the tested ones that are at rest.

        A landmark whose position varies more than noise explains, in several consecutive groups, is
        dynamic; one that has been at rest for long is static again.
        """
        import relmap.core.grouping.averaging_kernels as kernels

        of, still = self.table, rests(relative, noise_m)
        strikes, until = (of.strikes, of.struck_until), (of.tested_until, of.moved_until)
        columns = of.restless, *strikes, of.dynamic, *until, of.moving_bin
        seen = relative.used, relative.n_used, relative.iterations
        return kernels.tested(columns, relative.landmarks, still, *seen)


def rests(relative: RelativeMap, noise_m: float) -> Bools:
    """Return which positions vary no more than noise explains; (n,).

    The noise is that of most landmarks, or the landmark's own if known.
    """
    import relmap.core.grouping.averaging_kernels as kernels

    of = relative.positions, relative.variance, relative.amplified, relative.given
    return kernels.steady(*of, noise_m)


def binned(
    block: Floats,
    noise_m: float,
    priority: Floats,
    allowed: float | None = None,
    counts: tuple[Ints, float] | None = None,
) -> Bins:
    """Sort the landmarks of a block into bins, until half of them, or of the priority, are in one.

    Landmarks with too few observations, or that match no other, are in none.

    `block` (n, i, d), robot frame, metres: NaN where missing; `noise_m`: standard deviation of an
    observed coordinate. `priority` (n,): bins are started from landmarks in descending priority.
    `allowed`: maximum number of comparisons; by default n log2 n for the n landmarks with enough
    observations. `counts`: see `PointChart.counted`; by default counted here.
    """
    import relmap.core.grouping.binning_kernels as kernels

    n_seen, largest_m = counts or kernels.counted(block)
    often, exact_m = n_seen >= FEWEST, EXACT * (math.sqrt(block.shape[2]) * largest_m)
    if allowed is None:
        allowed = n_log_n(int(np.count_nonzero(often)))
    limit = LIMIT * 2 * max(noise_m, exact_m) ** 2
    bin_of, n_comparisons = kernels.sort_into_bins(block, often, priority, limit, int(allowed))
    bins = (-np.bincount(bin_of + 1)[1:]).argsort(kind="stable")
    return Bins([(bin_of == number).nonzero()[0] for number in bins], n_comparisons)


def n_log_n(n: int) -> float:
    """Return n log2 n, the maximum number of comparisons among n landmarks."""
    return n * math.log2(max(n, 2))
