"""Averaging a chart, and which of its landmarks move, compiled; see `completion` and `dynamics`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Counts, Floats, Ints
from relmap.core.geometry.fitting_kernels import enter_swings, fit_about, set_placement
from relmap.core.grouping.completion import AMPLE, NEARLY, PLENTY, ROUNDS, SOLID
from relmap.core.grouping.dynamics import ENOUGH, EXACT, FEWEST, LIMIT, STILL, STRIKES
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import median, smallest
from relmap.core.linalg.small_kernels import identity
from relmap.core.state.table import NONE

Columns = tuple[Bools, Counts, Counts, Bools, Counts, Counts, Counts]
"""Of the landmark table: restless, strikes, struck_until, dynamic, tested_until, moved_until,
moving_bin."""
Completed = tuple[Floats, Floats, Bools, Ints, Floats, Floats, Floats]


@compiled
def steady(
    positions: Floats, variance: Floats, amplified: Floats, given: Floats | None, noise_m: float
) -> Bools:
    """Return which positions (n, d) vary no more than noise explains; see `dynamics.rests`."""
    (n, d), largest = positions.shape, 0.0
    for k in range(n):
        for a in range(d):  # NaN is never larger
            largest = abs(positions[k, a]) if abs(positions[k, a]) > largest else largest
    exact_m = EXACT * (np.sqrt(d) * largest)
    noise = (exact_m if exact_m > noise_m else noise_m) ** 2
    still = np.empty(n, dtype=np.bool_)
    for k in range(n):
        own = noise if given is None else max(noise, given[k])
        still[k] = (0.0 if np.isnan(variance[k]) else variance[k]) <= LIMIT * own * amplified[k]
    return still


@compiled
def tested(
    columns: Columns, landmarks: Ints, still: Bools, used: Bools, n_used: Ints, iterations: Ints
) -> Bools:
    """Update which landmarks (n,) move, given which are still; see `dynamics.DynamicStatus.test`.

    `used` (n, i): observations averaged; `n_used` (n,): how many; `iterations` (i,). Returns
    which tested ones are at rest (n,).
    """
    restless, strikes, struck_until, dynamic, tested_until, moved_until, moving_bin = columns
    n, m = used.shape
    rests = np.empty(n, dtype=np.bool_)
    for k in range(n):
        one, first, last, fresh = landmarks[k], m, m - 1, 0
        for i in range(m):
            if used[k, i]:
                first, last = min(first, i), i
                fresh += iterations[i] > struck_until[one]
        begin, end = iterations[first % m], iterations[last]
        restless[one] = not still[k] and n_used[k] >= FEWEST
        is_tested = n_used[k] >= ENOUGH
        moves = is_tested and not still[k]
        if is_tested and fresh >= FEWEST:
            strikes[one] = strikes[one] + 1 if moves else 0
            struck_until[one] = iterations[m - 1] if moves else struck_until[one]
        dynamic[one] |= strikes[one] >= STRIKES
        moved_until[one] += max(begin - 1 - tested_until[one], 0)
        tested_until[one] = max(tested_until[one], end)
        if moves:
            moved_until[one] = end
        elif is_tested and end - moved_until[one] > STILL:
            dynamic[one], moving_bin[one] = False, NONE
        rests[k] = n_used[k] >= FEWEST and still[k] and not dynamic[one]
    return rests


@helper
def place(points: Floats, R: Floats, t: Floats, i: int, placed: Floats) -> None:
    """Transform points (n, d) of iteration i, and store their places (n, d)."""
    d = points.shape[1]
    for a in range(d):  # a coordinate at a time: faster than a point at a time
        x, y, z, shift = R[i, a, 0], R[i, a, 1], R[i, a, d - 1], t[i, a]
        for k in range(len(points)):
            at = shift + x * points[k, 0] + y * points[k, 1]
            placed[k, a] = at + z * points[k, 2] if d == 3 else at


@helper
def _averages(
    placed: Floats, seen: Ints, n_placed: Ints, counts: Ints, amplified: Floats, mean: Floats
) -> Floats:
    """Return the sums of squared deviations (n,) of the places of landmarks from their means.

    `placed` (i, n, d), `seen` (i, n): the first `n_placed` (i,) of each iteration, and of which
    landmarks they are. Sums of places (n, d), and of amplified variances (n,), become means, given
    the counts (n,). The largest deviation of each landmark is left out: one bad observation is not
    a motion.
    """
    n, d = mean.shape
    squares, largest = np.zeros(n), np.zeros(n)
    for k in range(n):
        amplified[k] /= counts[k]
        for a in range(d):
            mean[k, a] /= counts[k]
    for i in range(len(placed)):
        for j in range(n_placed[i]):
            k, square = seen[i, j], 0.0
            for a in range(d):
                apart = placed[i, j, a] - mean[k, a]
                square += apart * apart
            squares[k] += square
            largest[k] = max(largest[k], square)
    for k in range(n):
        squares[k] -= largest[k]
    return squares


@helper
def by_iteration(block: Floats, shown: Bools) -> tuple[Ints, Ints, Floats]:
    """Return how many landmarks of a block (n, i, d) each iteration shows, which, and their points.

    `shown` (n, i). In the order of the landmarks; (i,), (i, n) and (i, n, d).
    """
    n, m, d = block.shape
    n_seen, points = np.zeros(m, dtype=np.int64), np.empty((m, n, d))
    seen = np.empty((m, n), dtype=np.int64)
    for k in range(n):
        for i in range(m):
            if shown[k, i]:
                j = n_seen[i]
                seen[i, j], n_seen[i] = k, j + 1
                for a in range(d):
                    points[i, j, a] = block[k, i, a]
    return n_seen, seen, points


@helper
def _enter_matches(
    own: Floats, landmarks: Ints, reference: Floats, source: Floats, there: Floats, means: Floats
) -> int:
    """Write the points (k, d) of landmarks (k,) in a reference (n, d), and where; return how many.

    The reference is NaN for other landmarks. Also writes the means (2, 3) of both.
    """
    n, x, y, z, u, v, w = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(len(own)):
        k = landmarks[j]
        if not np.isnan(reference[k, 0]):
            for a in range(own.shape[1]):
                source[n, a], there[n, a] = own[j, a], reference[k, a]
            x, y, u, v, n = x + own[j, 0], y + own[j, 1], u + there[n, 0], v + there[n, 1], n + 1
            if own.shape[1] == 3:
                z, w = z + own[j, 2], w + reference[k, 2]
    share = 1 / max(n, 1)
    means[0, 0], means[0, 1], means[0, 2] = x * share, y * share, z * share
    means[1, 0], means[1, 1], means[1, 2] = u * share, v * share, w * share
    return n


@helper
def _place_iterations(block: Floats, shown: Bools, reference: Floats) -> Completed:
    """Fit every iteration of a block (n, i, d) to a reference (n, d) and average; see `complete`.

    `shown` (n, i): which observations there are. Returns R (i, d, d), t (i, d), which observations
    are placed (n, i), and how many of each landmark (n,); then, defined for landmarks ever placed,
    the mean place (n, d), its variance without the largest deviation, and that variance relative to
    the noise.
    """
    n, m, d = block.shape
    R, t, used = np.empty((m, d, d)), np.empty((m, d)), np.zeros((n, m), dtype=np.bool_)
    counts = np.zeros(n, dtype=np.int64)
    n_seen, seen, here = by_iteration(block, shown)
    source, there, rows = np.empty((n, d)), np.empty((n, d)), np.empty(n, dtype=np.bool_)
    placed, mean, guess = np.empty((n, d)), np.zeros((n, d)), identity(d)
    amplified, swing, means = np.zeros(n), np.empty(n), np.empty((2, 3))
    for k in range(n):
        rows[k] = True
    for i in range(m):
        own = here[i, : n_seen[i]]
        n_fitted = _enter_matches(own, seen[i], reference, source, there, means)
        turn, shift, is_fixed, scatter = fit_about(
            means, source[:n_fitted], there[:n_fitted], rows, guess
        )
        set_placement(R, t, i, turn, shift)
        if is_fixed:
            for a in range(d):  # `guess = turn` would count references with each observation
                for b in range(d):
                    guess[a, b] = turn[a, b]
            enter_swings(own, means, float(n_fitted), scatter, swing)
            place(own, R, t, i, placed)
            for j in range(len(own)):
                k = seen[i, j]
                used[k, i], counts[k] = True, counts[k] + 1
                amplified[k] += swing[j]
                amplified[k] += 1.0
                for a in range(d):
                    own[j, a] = placed[j, a]
                    mean[k, a] += placed[j, a]
        else:
            n_seen[i] = 0
    variance = _averages(here, seen, n_seen, counts, amplified, mean)
    for k in range(n):
        variance[k] = variance[k] / (d * (counts[k] - 2)) if counts[k] > 2 else np.nan
    return R, t, used, counts, mean, variance, amplified


@compiled
def completed(
    block: Floats, reference: Floats, moves: Bools, given: Floats | None, noise_m: float
) -> Completed:
    """Complete a reference (n, d) by the landmarks of a block (n, i, d); see `complete`.

    `given` (n,): variance of an observed coordinate. Returns what `_place_iterations` does.
    """
    n, d = reference.shape
    n_members, solid, rounds = 0, np.empty(n, dtype=np.bool_), 0
    shown = np.empty(block.shape[:2], dtype=np.bool_)
    for k in range(n):
        n_members += not np.isnan(reference[k, 0])
        for i in range(block.shape[1]):
            shown[k, i] = not np.isnan(block[k, i, 0])
    while True:
        whole = _place_iterations(block, shown, reference)
        _, _, _, counts, mean, variance, amplified = whole
        still = steady(mean, variance, amplified, given, noise_m)
        n_placed, n_solid, rounds = 0, 0, rounds + 1
        for k in range(n):
            solid[k] = counts[k] >= FEWEST and still[k] and not moves[k]
            solid[k] = solid[k] and amplified[k] <= SOLID * counts[k]
            n_placed, n_solid = n_placed + (counts[k] > 0), n_solid + solid[k]
        is_settled = n_members >= PLENTY and n_solid >= NEARLY * n_placed
        if is_settled or n_solid <= AMPLE * n_members or rounds == ROUNDS:
            return whole
        n_members = n_solid
        for k in range(n):
            for a in range(d):
                reference[k, a] = mean[k, a] if solid[k] else np.nan


@helper
def _radial_variances(block: Floats, inner: Bools, variance: Floats) -> None:
    """Write the variance (g,) of the distances of a group's members from its inner centre."""
    g, m, d = block.shape
    centre, radius, h = np.zeros((m, d)), np.empty(m), 0
    for k in range(g):
        h += inner[k]
    share = 1.0 / h
    for k in range(g):
        for i in range(m if inner[k] else 0):
            for a in range(d):
                centre[i, a] += share * block[k, i, a]
    for k in range(g):
        mean, squares = 0.0, 0.0
        for i in range(m):
            square = 0.0
            for a in range(d):
                square += (block[k, i, a] - centre[i, a]) ** 2
            radius[i] = np.sqrt(square)
            mean += radius[i]
        mean /= m
        for i in range(m):
            squares += (radius[i] - mean) ** 2
        # The centre contains 1/h of the noise of each of its members, correlated with theirs.
        variance[k] = squares / (m - 1) * (h / (h - 1) if inner[k] else h / (h + 1))


@compiled
def steady_variance(block: Floats, freedoms_median: float) -> float:
    """Return the typical variance of the distances of a group (g, i, d) from its centre.

    The centre is that of the steadier half, as a moving member would shift it.
    """
    g = len(block)
    inner, variance, listed, limit = np.zeros(g, dtype=np.bool_), np.zeros(g), np.empty(g), np.inf
    for _ in range(3):
        for k in range(g):
            inner[k] = variance[k] <= limit
        _radial_variances(block, inner, variance)
        for k in range(g):
            listed[k] = variance[k]
        limit = smallest(listed, min(max(3, (g + 1) // 2), g) - 1)
    return median(listed) / freedoms_median
