"""Binning landmarks by the distances between them; see `relmap.core.dynamics`."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled

TRIES = 2
"""How often a landmark may look for company before it counts as alone."""
VOTERS = 3
"""Further members that vote on who belongs to a bin."""


@compiled
def keeps_distance(block: NDArray[np.float64], a: int, b: int, limit: float, fewest: int) -> bool:
    """Tell whether the distance of two rows of a block (n, i, d) varies by no more than a limit.

    NaN marks what was not seen; fewer than `fewest` common iterations tell nothing.
    """
    m, d = block.shape[1:]
    count, mean, squares = 0, 0.0, 0.0
    for i in range(m):
        square = 0.0
        for k in range(d):
            apart = block[a, i, k] - block[b, i, k]
            square += apart * apart
        if not np.isnan(square):
            count += 1
            distance = np.sqrt(square)
            step = distance - mean
            mean += step / count
            squares += step * (distance - mean)
    return count >= fewest and squares <= limit * (count - 1)


@compiled
def _vote(
    block: NDArray[np.float64],
    near: NDArray[np.int64],
    n_voters: int,
    limit: float,
    fewest: int,
) -> tuple[NDArray[np.bool_], int]:
    """Let some members of a bin, from the outermost to the innermost, vote on the others.

    They catch what circles round the first member; nobody votes for himself.  Returns who stays
    (k,), and the number of comparisons.
    """
    k, m, d = len(near), block.shape[1], block.shape[2]
    place, centre = np.zeros((k, d)), np.zeros(d)
    for j in range(k):
        count = 0
        for i in range(m):
            if not np.isnan(block[near[j], i, 0]):
                count += 1
                place[j] += block[near[j], i]
        place[j] /= count
        centre += place[j] / k
    outward = np.argsort(((place - centre) ** 2).sum(axis=1), kind="mergesort")
    votes, asked, n = np.zeros(k, dtype=np.int64), np.zeros(k, dtype=np.int64), 0
    for v in range(n_voters):
        voter = outward[v * (k - 1) // max(n_voters - 1, 1)]
        for j in range(k):
            if j != voter:
                n += 1
                asked[j] += 1
                votes[j] += keeps_distance(block, near[voter], near[j], limit, fewest)
    return 2 * votes >= asked, n


@compiled
def _company(
    block: NDArray[np.float64],
    pivot: int,
    others: NDArray[np.int64],
    samples: tuple[int, int],
    budget: int,
    limit: float,
    fewest: int,
) -> tuple[NDArray[np.int64], int]:
    """Return which others keep their distance from a pivot, and the number of comparisons.

    Whoever is static finds company in a small sample, here and there of all: where nobody in the
    sample agrees, or the budget is too small, nobody is returned.  Of the samples, so many in all,
    one is taken by its number.
    """
    n_samples, number = samples
    agrees, n = np.zeros(len(others), dtype=np.bool_), 0
    in_sample = np.arange(len(others)) % n_samples == number % n_samples
    for asked in (in_sample, ~in_sample):
        if n + asked.sum() > budget:
            return others[:0], n
        for j in np.flatnonzero(asked):
            agrees[j] = keeps_distance(block, pivot, others[j], limit, fewest)
        n += asked.sum()
        if not agrees.any():
            break
    return others[agrees], n


@compiled
def _bin_with(
    block: NDArray[np.float64],
    pivot: int,
    others: NDArray[np.int64],
    samples: tuple[int, int],
    budget: int,
    limit: float,
    fewest: int,
) -> tuple[NDArray[np.int64], int]:
    """Return the other members of the bin that a pivot begins, and the number of comparisons."""
    near, n = _company(block, pivot, others, samples, budget, limit, fewest)
    n_voters = min(VOTERS, len(near), (budget - n) // max(len(near) - 1, 1))
    if len(near) > 1 and n_voters > 0:
        stays, n_votes = _vote(block, near, n_voters, limit, fewest)
        return near[stays], n + n_votes
    return near, n


@compiled
def sort_into_bins(
    block: NDArray[np.float64],
    priority: NDArray[np.float64],
    limit: float,
    fewest: int,
    sample: int,
    allowed: int,
) -> tuple[NDArray[np.int64], int]:
    """Sort the rows of a block (n, i, d) into bins; see `relmap.core.dynamics.Binning`.

    Returns the number of each row's bin, -1 where it is in none, and the comparisons made.
    """
    free = np.array([(~np.isnan(row[:, 0])).sum() >= fewest for row in block])
    queue = [(0, -priority[row], row) for row in np.flatnonzero(free)]
    heapq.heapify(queue)
    bin_of, n_bins, n_comparisons = np.full(len(block), -1), 0, 0
    n_all, weight, largest = len(queue), priority[free].sum(), 0
    while queue and n_comparisons < allowed and largest < free.sum():
        tries, negative, pivot = heapq.heappop(queue)
        if not free[pivot]:
            continue
        free[pivot] = False
        others = np.flatnonzero(free)
        samples = (max(len(others) // sample, 1), tries)
        budget = allowed - n_comparisons
        members, compared = _bin_with(block, int(pivot), others, samples, budget, limit, fewest)
        n_comparisons += compared
        if len(members) == 0:
            if tries + 1 < TRIES and samples[0] > 1:
                free[pivot] = True
                heapq.heappush(queue, (tries + 1, negative, pivot))
            continue
        bin_of[pivot] = n_bins
        bin_of[members] = n_bins
        free[members] = False
        n_bins += 1
        largest = max(largest, 1 + len(members))
        # Half of the landmarks, or of what is known of them, in one bin: there is no larger one.
        held = priority[pivot] + priority[members].sum()
        if 2 * largest >= n_all or (weight > 0 and 2 * held >= weight):
            break
    return bin_of, n_comparisons
