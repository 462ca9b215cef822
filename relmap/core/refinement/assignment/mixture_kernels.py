"""Fitting few landmarks to the observations near them, compiled; see `mixture`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import factorise, solve, square_between
from relmap.core.refinement.assignment.mixture import LIMIT

ROUNDS = 8
"""Maximum number of rounds of assigning observations and averaging them."""
WEIGHINGS = 10
"""Number of rounds of weighing all assignments."""
FAINT = 1e-9
"""Weight, in observations, of where a landmark is: some have no observation nearby."""


@helper
def _assign(gain: Floats, best: Floats, choice: Ints, found: Ints, begin: int, n: int) -> float:
    """Assign the observations of a scan to landmarks so that the sum of the gains is largest.

    Exact, by dynamic programming over the sets of landmarks that are taken. `gain` (n, k), positive
    where an assignment is possible; `best`, `choice`: overwritten; `found`: written from `begin`.
    """
    k = gain.shape[1]
    n_sets = 1 << k
    for taken in range(n_sets):
        best[taken] = 0.0 if taken == 0 else -np.inf
    for i in range(n):
        for taken in range(n_sets - 1, -1, -1):
            choice[i, taken] = -1
            for j in range(k):
                if taken >> j & 1 and gain[i, j] > 0.0:
                    score = best[taken ^ (1 << j)] + gain[i, j]
                    if score > best[taken]:
                        best[taken], choice[i, taken] = score, j
    most = 0
    for taken in range(n_sets):
        most = taken if best[taken] > best[most] else most
    taken = most
    for i in range(n - 1, -1, -1):
        j = choice[i, taken]
        found[begin + i] = j
        taken ^= 0 if j < 0 else 1 << j
    return float(best[most])


@compiled
def fit_few(
    placed: Floats,
    metric: Floats,
    begin: Ints,
    odds: Floats,
    cost: float,
    means: Floats,
    found: Ints,
) -> float:
    """Fit landmarks to the observations around them; return how well these are explained.

    In turns, each scan is assigned to the landmarks, at most one observation to each, and each
    landmark is moved to the mean of its observations.

    `placed` (n, d): observations in the frame of the map, scan by scan; multiplied by `metric`
    (n, d, d), differences are in standard deviations. `begin` (s + 1,): where the observations of
    each scan begin, and the end; `odds` (s,): log odds that it shows a landmark here; `cost`: of
    each landmark, whether seen or not. Overwritten are `means` (k, d), the landmarks, and `found`
    (n,), the landmark of each observation, or -1. Returns the log likelihood, relative to
    observations of no landmark.
    """
    (n, d), k, longest = placed.shape, len(means), 0
    for s in range(len(odds)):
        longest = max(longest, begin[s + 1] - begin[s])
    best, choice = np.empty(1 << k), np.empty((longest, 1 << k), dtype=np.int64)
    gain, before, apart = np.empty((longest, k)), np.empty(n, dtype=np.int64), np.empty(d)
    weights, sums, score = np.empty((k, d, d)), np.empty((k, d)), 0.0
    for _ in range(ROUNDS):
        score = -cost * k
        for i in range(n):
            before[i] = found[i]
        for s in range(len(odds)):
            for i in range(begin[s], begin[s + 1]):
                for j in range(k):
                    square = square_between(placed[i], means[j], metric, i, apart)
                    gain[i - begin[s], j] = (LIMIT - square) / 2 + odds[s]
            score += _assign(gain, best, choice, found, begin[s], begin[s + 1] - begin[s])
        is_same = True
        for i in range(n):
            is_same &= before[i] == found[i]
        if is_same:
            break
        _average(placed, metric, found, means, weights, sums)
    return score


@helper
def _average(
    placed: Floats, metric: Floats, found: Ints, means: Floats, weights: Floats, sums: Floats
) -> None:
    """Move each landmark with observations to their mean; `weights`, `sums` are overwritten."""
    weights[:], sums[:] = 0.0, 0.0
    for i in range(len(found)):
        if found[i] >= 0:
            _add(placed[i], metric[i], 1.0, weights[found[i]], sums[found[i]])
    for j in range(len(means)):
        if weights[j, 0, 0] > 0:
            _divide(weights[j], sums[j], means[j])


@helper
def _add(point: Floats, metric: Floats, share: float, weights: Floats, sums: Floats) -> None:
    """Add the weights (d, d) of a share of an observation, and the weighted sums (d,)."""
    d = len(point)
    for a in range(d):
        for b in range(d):
            weight = 0.0
            for c in range(d):
                weight += metric[c, a] * metric[c, b]
            weights[a, b] += share * weight
            sums[a] += share * weight * point[b]


@helper
def _divide(weights: Floats, sums: Floats, mean: Floats) -> None:
    """Write the mean (d,); `weights`, `sums` are overwritten."""
    factorise(weights)
    solve(weights, sums)
    for a in range(len(mean)):
        mean[a] = sums[a]


@compiled
def settle_few(
    placed: Floats, metric: Floats, begin: Ints, odds: Floats, means: Floats
) -> tuple[float, float]:
    """Move landmarks to the means of all observations, by how probable it is that they are theirs.

    Expectation and maximisation in turns (Dempster, Laird and Rubin, 1977). The arguments are those
    of `fit_few`. Returns the sum of the squared errors, and the number of observations.
    """
    (n, d), k, square, weight = placed.shape, len(means), 0.0, 0.0
    squares, share, apart = np.empty((n, k)), np.empty((n, k)), np.empty(d)
    weights, sums = np.empty((d, d)), np.empty(d)
    for _ in range(WEIGHINGS):
        _enter_squares(placed, metric, means, squares, apart)
        for s in range(len(odds)):
            for i in range(begin[s], begin[s + 1]):
                for j in range(k):
                    squares[i, j] = np.exp((LIMIT - squares[i, j]) / 2 + odds[s])
        share = weigh(squares, begin)
        for j in range(k):
            _settle(placed, metric, share[:, j], means[j], weights, sums)
    _enter_squares(placed, metric, means, squares, apart)
    for i in range(n):
        for j in range(k):
            square += share[i, j] * squares[i, j]
            weight += share[i, j]
    return square, weight


@helper
def _settle(
    placed: Floats, metric: Floats, share: Floats, mean: Floats, weights: Floats, sums: Floats
) -> None:
    """Move a landmark to the mean of shares (n,); `weights`, `sums` are overwritten."""
    for a in range(len(mean)):
        for b in range(len(mean)):
            weights[a, b] = FAINT if a == b else 0.0
        sums[a] = FAINT * mean[a]
    for i in range(len(share)):
        _add(placed[i], metric[i], share[i], weights, sums)
    _divide(weights, sums, mean)


@helper
def _enter_squares(
    placed: Floats, metric: Floats, means: Floats, squares: Floats, apart: Floats
) -> None:
    """Write the squared distances (n, k); `apart` (d,) is overwritten."""
    for i in range(len(placed)):
        for j in range(len(means)):
            squares[i, j] = square_between(placed[i], means[j], metric, i, apart)


@compiled
def weigh(odds: Floats, begin: Ints) -> Floats:
    """Return how probable it is that an observation is that of a landmark; (n, k).

    Each scan shows a landmark at most once. Exact, by sums over the sets of landmarks that the
    observations before, and after, one are of.

    `odds` (n, k): of each assignment by itself, relative to that of no landmark; `begin` (s + 1,):
    where the observations of each scan begin, and the end.
    """
    (n, k), longest = odds.shape, 0
    for s in range(len(begin) - 1):
        longest = max(longest, begin[s + 1] - begin[s])
    before, after = np.zeros((longest + 1, 1 << k)), np.zeros((longest + 1, 1 << k))
    share = np.zeros((n, k))
    for s in range(len(begin) - 1):
        here = slice(begin[s], begin[s + 1])
        _weigh(odds[here], before, after, share[here])
    return share


@helper
def _weigh(odds: Floats, before: Floats, after: Floats, share: Floats) -> None:
    """Weigh the assignments of a scan's observations (n, k); `share` (n, k): zeros.

    `before`, `after` (n + 1, 2^k): sums over the observations before and from each one on, by the
    set of landmarks taken before it.
    """
    (n, k), n_sets = odds.shape, before.shape[1]
    before[0], after[n] = 0.0, 1.0
    before[0, 0] = 1.0
    for i in range(n):
        for taken in range(n_sets):
            before[i + 1, taken] = before[i, taken]
            for j in range(k):
                if taken >> j & 1:
                    before[i + 1, taken] += before[i, taken ^ 1 << j] * odds[i, j]
    for i in range(n - 1, -1, -1):
        for taken in range(n_sets):
            after[i, taken] = after[i + 1, taken]
            for j in range(k):
                if not taken >> j & 1:
                    one = odds[i, j] * after[i + 1, taken | 1 << j]
                    after[i, taken] += one
                    share[i, j] += before[i, taken] * one
    share /= after[0, 0]
