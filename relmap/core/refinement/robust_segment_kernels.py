"""Alignment of a segment with wrong observations, compiled; see `condensing`.

Least squares would turn some iterations against the others, and all would seem to be as wrong.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.fitting_kernels import fit_about, misfits, set_placement
from relmap.core.grouping.averaging_kernels import place
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import median
from relmap.core.linalg.small_kernels import picked, true_rows
from relmap.core.refinement.aligning_kernels import (
    STILL,
    fullest,
    join,
    leave_out,
    next_tied,
    settle,
    shared_of,
)
from relmap.core.refinement.segment_kernels import EXACT, OUTLIER, TRIMS

ROUNDS = 100
"""Maximum number of rounds: iterations that share few landmarks move slowly."""
FITS = 10
"""Rounds of weights in the fit of one iteration."""
NEAR = 0.01
"""Distance, in medians, below which a smaller one gives no larger weight."""


@helper
def _fit_weighted(
    here: Floats, there: Floats, weight: Floats, rows: Bools, guess: Floats
) -> tuple[Floats, Floats, bool]:
    """Fit matched points (n, d) of weights (n,) rigidly; return R, t and whether R is fixed.

    `rows` (n,): all true.
    """
    n, d = here.shape
    source, target, means, total = np.empty((n, d)), np.empty((n, d)), np.zeros((2, 3)), 0.0
    for i in range(n):
        total += weight[i]
        for a in range(d):
            means[0, a] += weight[i] * here[i, a]
            means[1, a] += weight[i] * there[i, a]
    for a in range(d):
        means[0, a] /= max(total, 1e-300)
        means[1, a] /= max(total, 1e-300)
    for i in range(n):
        root = np.sqrt(weight[i])
        for a in range(d):
            source[i, a] = root * (here[i, a] - means[0, a])
            target[i, a] = root * (there[i, a] - means[1, a])
    R, t, is_fixed, _ = fit_about(np.zeros((2, 3)), source, target, rows, guess)
    for a in range(d):
        t[a] = means[1, a]
        for b in range(d):
            t[a] -= R[a, b] * means[0, b]
    return R, t, is_fixed


@helper
def _stretches(source: Floats, target: Floats) -> Floats:
    """Return the median change (n,) of the distances of each of matched points (n, d) from others.

    It is small for right matches, if more than half are.
    """
    n, found, change = len(source), np.empty(len(source)), np.empty(len(source))
    for i in range(n):
        for j in range(n):
            here, there = 0.0, 0.0
            for a in range(source.shape[1]):
                here += (source[i, a] - source[j, a]) ** 2
                there += (target[i, a] - target[j, a]) ** 2
            change[j] = abs(np.sqrt(here) - np.sqrt(there))
        found[i] = median(change)
    return found


@helper
def _fit_by_distances(
    here: Floats, there: Floats, rows: Bools, guess: Floats
) -> tuple[Floats, Floats, float]:
    """Fit some rows of matched points (n, d) so that the sum of distances is least (Weiszfeld).

    The first weights come from distances between points, as a wrong match far away would turn the
    first fit. Returns R, t and the square of the limit of outliers.
    """
    own = true_rows(rows)
    source, target, every = picked(here, own), picked(there, own), np.ones(len(own), np.bool_)
    apart, weight = _stretches(source, target), np.empty(len(own))
    R, t, middle = guess, np.zeros(here.shape[1]), 0.0
    for _ in range(FITS):
        middle = median(apart.copy())
        for i in range(len(own)):
            weight[i] = 1 / max(apart[i], NEAR * middle, 1e-300)
        R, t, _ = _fit_weighted(source, target, weight, every, R)
        apart = misfits(source, target, R, t)
    return R, t, (OUTLIER * median(apart)) ** 2


@helper
def _join(block: Floats, seen: Bools, free: Bools) -> tuple[Bools, Floats, Floats]:
    """Align iterations as `join` does, without observations that contradict earlier ones.

    Of two that contradict each other the later one is used.
    """
    n, k, d = block.shape
    R, t, joined = np.zeros((k, d, d)), np.zeros((k, d)), np.zeros(k, dtype=np.bool_)
    placed, here, rows = np.empty((n, d)), np.empty((n, d)), np.zeros(n, dtype=np.bool_)
    sums, counts, reference = np.zeros((n, d)), np.zeros(n), np.zeros((n, d))
    seed, left, step, at, limit = fullest(seen), free.copy(), -1, 0, 0.0
    while True:
        step, at, turn, shift = next_tied(
            block, seen, left, counts, reference, seed, step, here, rows
        )
        if at < 0:
            break
        if at != seed:
            turn, shift, limit = _fit_by_distances(here, reference, rows, turn)
        joined[at], left[at] = True, False
        set_placement(R, t, at, turn, shift)
        place(here, R, t, at, placed)
        for i in range(n):
            square = 0.0
            for a in range(d):
                square += (placed[i, a] - reference[i, a]) ** 2 if rows[i] else 0.0
            if not seen[i, at] or (square > limit and counts[i] > 1):
                continue
            keeps = square <= limit
            counts[i] = counts[i] + 1 if keeps else 1.0
            for a in range(d):
                sums[i, a] = placed[i, a] + (sums[i, a] if keeps else 0.0)
                reference[i, a] = sums[i, a] / counts[i]
    leave_out(seen, joined)
    return joined, R, t


@helper
def _enter_targets(
    placed: Floats, n_of: Ints, of: Ints, weight: Floats, counts: Ints, apart: Floats
) -> float:
    """Replace the places (k, n, d) of points by the weighted means of their landmarks.

    Also writes their distances (k, n) as errors, and returns the sum of their squares, each over
    the square of the number of points in the iteration.
    """
    k, n, d = placed.shape
    mean, total, square = np.zeros((n, d)), np.zeros(n), 0.0
    for m in range(k):
        for j in range(n_of[m]):
            total[of[m, j]] += weight[m, j]
            for a in range(d):
                mean[of[m, j], a] += weight[m, j] * placed[m, j, a]
    for m in range(k):
        for j in range(n_of[m]):
            i, off = of[m, j], 0.0
            for a in range(d):
                off += (placed[m, j, a] - mean[i, a] / total[i]) ** 2
                placed[m, j, a] = mean[i, a] / total[i]
            square += weight[m, j] * off / n_of[m] ** 2
            apart[m, j] = np.sqrt(off / (1 - 1 / counts[i]))
    return square


@helper
def _median_of(apart: Floats, n_of: Ints) -> float:
    """Return the median of the errors (k, n), of which each iteration has `n_of` (k,)."""
    listed, count = np.empty(apart.size), 0
    for m in range(len(n_of)):
        for j in range(n_of[m]):
            listed[count], count = apart[m, j], count + 1
    return median(listed[:count]) if count else 0.0


@helper
def _settle(
    block: Floats, seen: Bools, joined: Bools, R: Floats, t: Floats
) -> tuple[Ints, Ints, Floats]:
    """Align the iterations of a segment as `settle` does, with Huber's weights (1964).

    Beyond the median error the influence of an observation is constant. Returns how many landmarks
    each iteration shares with others, which, and the errors; (k,), (k, n) and (k, n).
    """
    n, k, d = block.shape
    n_of, of, here, counts = shared_of(block, seen)
    placed, rows, weight = np.empty((k, n, d)), np.ones(n, dtype=np.bool_), np.ones((k, n))
    apart = np.empty((k, n))
    for _ in range(ROUNDS):
        for m in range(k):
            place(here[m, : n_of[m]], R, t, m, placed[m])
        square, moved = _enter_targets(placed, n_of, of, weight, counts, apart), 0.0
        for m in range(k):
            c = n_of[m]
            if joined[m] and c > 0:
                turn, shift, fixed = _fit_weighted(
                    here[m, :c], placed[m, :c], weight[m, :c], rows[:c], R[m].copy()
                )
                for a in range(d):
                    moved += (shift[a] - t[m, a]) ** 2 if fixed else 0.0
                if fixed:
                    set_placement(R, t, m, turn, shift)
        if moved <= STILL * STILL * square:
            break
        typical = max(_median_of(apart, n_of), 1e-300)
        for m in range(k):
            for j in range(n_of[m]):
                weight[m, j] = typical / max(apart[m, j], typical)
    return n_of, of, apart


@helper
def _drop(n_of: Ints, of: Ints, apart: Floats, limit: float, seen: Bools) -> bool:
    """Drop the observations whose errors (k, n) are above a limit; return whether any is."""
    found = False
    for m in range(len(n_of)):
        for j in range(n_of[m]):
            if apart[m, j] > limit:
                seen[of[m, j], m], found = False, True
    return found


@compiled
def align_robustly(
    block: Floats, seen: Bools, free: Bools, usual_m: float
) -> tuple[Bools, Floats, Floats]:
    """Align iterations as `align_iterations` does; drop outliers among the observations (n, k).

    `usual_m`: standard deviation of a coordinate in other segments, metres.
    """
    extent = 0.0
    for i in range(len(block)):
        for m in range(block.shape[1]):
            for a in range(block.shape[2]):
                extent = max(extent, abs(block[i, m, a]) if seen[i, m] else 0.0)
    joined, R, t = _join(block, seen, free)
    for _ in range(TRIMS):
        n_of, of, apart = _settle(block, seen, joined, R, t)
        limit = max(OUTLIER * max(_median_of(apart, n_of), usual_m), EXACT * extent)
        if not _drop(n_of, of, apart, limit, seen):
            break
        # What ties an iteration to the others may have been dropped.
        joined, R, t = join(block, seen, joined)
    settle(block, seen, joined, R, t)
    return joined, R, t
