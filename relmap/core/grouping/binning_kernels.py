"""Binning landmarks by their mutual distances; see `relmap.core.grouping.dynamics`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.grouping.dynamics import FEWEST, SAMPLE
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import smallest
from relmap.core.linalg.small_kernels import true_rows, unset

TRIES = 2
"""Maximum number of attempts of a landmark to start a bin."""
VOTERS = 3
"""Further members that vote on the members of a bin."""


@helper
def keeps_distance(block: Floats, a: int, b: int, limit: float) -> bool:
    """Return whether the distance of two rows of a block (n, i, d) varies within a limit.

    NaN marks missing observations; with fewer than `FEWEST` common iterations the answer is no.
    """
    _, m, d = block.shape
    count, first, total, squares = 0, 0.0, 0.0, 0.0
    for i in range(m):
        square = 0.0
        for k in range(d):
            apart = block[a, i, k] - block[b, i, k]
            square += apart * apart
        if not np.isnan(square):
            distance = np.sqrt(square)
            first = distance if count == 0 else first
            count += 1
            total += distance - first
            squares += (distance - first) ** 2
    return count >= FEWEST and squares - total * total / count <= limit * (count - 1)


@helper
def _outward(block: Floats, near: Ints) -> Floats:
    """Return the squared distances (k,) of the mean places of some rows from their centre."""
    k, m, d = len(near), block.shape[1], block.shape[2]
    place, centre, square = np.zeros((k, d)), np.zeros(d), np.zeros(k)
    for j in range(k):
        count = 0
        for i in range(m):
            if not np.isnan(block[near[j], i, 0]):
                count += 1
                for a in range(d):
                    place[j, a] += block[near[j], i, a]
        for a in range(d):
            place[j, a] /= count
            centre[a] += place[j, a] / k
    for j in range(k):
        for a in range(d):
            square[j] += (place[j, a] - centre[a]) ** 2
    return square


@helper
def _vote(block: Floats, near: Ints, n_voters: int, limit: float) -> tuple[Ints, int]:
    """Let some members of a bin, from the outermost to the innermost, vote on the others.

    This excludes landmarks that circle round the first member; none votes for itself. Returns the
    members that stay, and the number of comparisons.
    """
    k, n_stay = len(near), 0
    outward, listed = _outward(block, near), np.empty(k)
    votes, stay = np.zeros(k), np.empty(k, dtype=np.int64)
    for v in range(n_voters):
        for j in range(k):
            listed[j] = outward[j]
        rank = smallest(listed, v * (k - 1) // max(n_voters - 1, 1))
        voter = 0
        for j in range(k):
            voter = j if outward[j] == rank else voter
        for j in range(k):  # half of the voters are enough
            if j != voter:
                agrees = keeps_distance(block, near[voter], near[j], limit)
                votes[j] += 1 if agrees else -1
    for j in range(k):
        if votes[j] >= 0:
            stay[n_stay] = near[j]
            n_stay += 1
    return stay[:n_stay], n_voters * (k - 1)


@helper
def _bin_with(
    block: Floats, pivot: int, others: Ints, sample: tuple[int, int], budget: int, limit: float
) -> tuple[Ints, int]:
    """Return the other members of the bin that a pivot begins, and the number of comparisons.

    A static landmark agrees with others in a small sample of all.  If none in the sample agrees, or
    the budget is too small, there are none.  The sample is every k-th row from a given start.
    """
    every, first = sample
    agrees, near = np.zeros(len(others), dtype=np.bool_), np.empty(len(others), dtype=np.int64)
    n, n_near = 0, 0
    for in_sample in (True, False):
        n_sample = (len(others) - first + every - 1) // every
        n_asked = n_sample if in_sample else len(others) - n_sample
        if n + n_asked > budget:
            return near[:0], n
        for j in range(len(others)):
            if (j % every == first) == in_sample:
                agrees[j] = keeps_distance(block, pivot, others[j], limit)
                n_near += agrees[j]
        n += n_asked
        if n_near == 0:
            break
    n_near = 0
    for j in range(len(others)):
        if agrees[j]:
            near[n_near] = others[j]
            n_near += 1
    n_voters = min(VOTERS, n_near, (budget - n) // max(n_near - 1, 1))
    if n_near > 1 and n_voters > 0:
        stay, n_votes = _vote(block, near[:n_near], n_voters, limit)
        return stay, n + n_votes
    return near[:n_near], n


@helper
def _next_pivot(free: Bools, tries: Ints, priority: Floats) -> int:
    """Return the free row with the fewest attempts, ties by priority, or -1."""
    best = -1
    for row in range(len(free)):
        if free[row]:
            fewer = best < 0 or tries[row] < tries[best]
            if fewer or (tries[row] == tries[best] and priority[row] > priority[best]):
                best = row
    return best


@compiled
def counted(block: Floats) -> tuple[Ints, float]:
    """Return the number of observations of each row (n,) of a block, and its largest coordinate."""
    n, m, d = block.shape
    counts, largest = np.zeros(n, dtype=np.int64), 0.0
    for k in range(n):
        for i in range(m):
            counts[k] += np.isfinite(block[k, i, 0])
            for a in range(d):  # NaN is never larger
                largest = abs(block[k, i, a]) if abs(block[k, i, a]) > largest else largest
    return counts, largest


@compiled
def sort_into_bins(
    block: Floats, free: Bools, priority: Floats, limit: float, allowed: int
) -> tuple[Ints, int]:
    """Sort free rows of a block (n, i, d) into bins; see `relmap.core.grouping.dynamics.binned`.

    Returns the bin of each row, -1 if in none, and the number of comparisons. `free` (n,) is
    changed.
    """
    bin_of, tries = unset(len(block)), np.zeros(len(block), dtype=np.int64)
    n_bins, n_comparisons, n_all, weight, largest = 0, 0, 0, 0.0, 0
    for row in range(len(block)):
        n_all += free[row]
        weight += priority[row] if free[row] else 0.0
    pivot = _next_pivot(free, tries, priority)
    while pivot >= 0 and n_comparisons < allowed:
        free[pivot] = False
        others = true_rows(free)
        if largest > len(others):
            break
        every = max(len(others) // SAMPLE, 1)
        sample, budget = (every, tries[pivot] % every), allowed - n_comparisons
        members, compared = _bin_with(block, pivot, others, sample, budget, limit)
        n_comparisons += compared
        tries[pivot] += 1
        if len(members) == 0:
            free[pivot] = tries[pivot] < TRIES and every > 1
        else:
            bin_of[pivot] = n_bins
            held = priority[pivot]
            for j in range(len(members)):
                bin_of[members[j]] = n_bins
                free[members[j]] = False
                held += priority[members[j]]
            n_bins += 1
            largest = max(largest, 1 + len(members))
            # Half of the landmarks, or of the known ones, in one bin: there is no larger bin.
            if 2 * largest >= n_all or (weight > 0 and 2 * held >= weight):
                break
        pivot = _next_pivot(free, tries, priority)
    return bin_of, n_comparisons
