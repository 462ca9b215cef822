"""Alignment of the iterations of a segment, compiled; see `relmap.core.refinement.condensing`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.fitting_kernels import (
    centre_of,
    fit_about,
    fit_rows,
    set_placement,
)
from relmap.core.grouping.averaging_kernels import by_iteration, place
from relmap.core.linalg.compiling import helper
from relmap.core.linalg.small_kernels import diagonalise, identity

LEVERAGE = 20.0
"""Largest distance of an iteration's points, relative to those that align it to its segment."""
ROUNDS, STILL = 10, 0.01
"""Maximum number of rounds of alignment in a segment, and movement in a round, relative to the
standard error, below which no further one is needed. Each reduces the error about fivefold."""


@helper
def _is_tied(here: Floats, rows: Bools, scatter: Floats) -> bool:
    """Return whether some rows of an iteration, NaN where missing, determine its pose well."""
    x, y, z, _ = centre_of(here, rows)
    across, farthest = scatter[0, 0] + scatter[1, 1], 0.0
    if here.shape[1] == 3:  # the second largest eigenvalue
        diagonalise(scatter)
        a, b, c = scatter[0, 0], scatter[1, 1], scatter[2, 2]
        across = max(min(a, b), min(max(a, b), c))
    for i in range(len(here)):
        square = (here[i, 0] - x) ** 2 + (here[i, 1] - y) ** 2
        square += (here[i, 2] - z) ** 2 if here.shape[1] == 3 else 0.0
        farthest = max(farthest, 0.0 if np.isnan(square) else square)
    return bool(farthest <= LEVERAGE * LEVERAGE * across)


@helper
def fullest(seen: Bools) -> int:
    """Return the first of the columns in which most landmarks are seen (n, k)."""
    counts = np.zeros(seen.shape[1])
    fullest = 0
    for i in range(len(seen)):
        for m in range(seen.shape[1]):
            counts[m] += seen[i, m]
    for m in range(len(counts)):
        fullest = m if counts[m] > counts[fullest] else fullest
    return fullest


@helper
def next_tied(
    block: Floats,
    seen: Bools,
    free: Bools,
    counts: Floats,
    reference: Floats,
    seed: int,
    step: int,
    here: Floats,
    rows: Bools,
) -> tuple[int, int, Floats, Floats]:
    """Return the next step of the search, the iteration found in it, or -1, and its R and t.

    The first is `seed`; others are searched from there outwards, and must be tied well to the
    `reference` (n, d) of landmarks seen before, those with `counts` (n,). Also writes the points
    (n, d) of the iteration, and which of them were seen before.
    """
    n, k, d = block.shape
    R, t = identity(d), np.zeros(d)
    for later in range(step + 1, step + 1 + 2 * k):
        turn = later % (2 * k)
        at, n_rows = seed + (turn + 1) // 2 * (1 if turn % 2 else -1), 0
        if at < 0 or at >= k or not free[at]:
            continue
        for i in range(n):
            rows[i] = seen[i, at] and counts[i] > 0
            n_rows += rows[i]
            for a in range(d):
                here[i, a] = block[i, at, a]
        R, t, fixed, scatter, _ = fit_rows(here, reference, rows, identity(d))
        if at == seed or (n_rows >= d and fixed and _is_tied(here, rows, scatter)):
            return turn, at, R, t
    return step, -1, R, t


@helper
def join(block: Floats, seen: Bools, free: Bools) -> tuple[Bools, Floats, Floats]:
    """Align iterations to the earlier ones, from the fullest outwards, while well determined.

    Observations of the other iterations are dropped.
    """
    n, k, d = block.shape
    R, t, joined = np.zeros((k, d, d)), np.zeros((k, d)), np.zeros(k, dtype=np.bool_)
    placed, here, rows = np.empty((n, d)), np.empty((n, d)), np.zeros(n, dtype=np.bool_)
    sums, counts, reference = np.zeros((n, d)), np.zeros(n), np.zeros((n, d))
    seed, left, step, at = fullest(seen), free.copy(), -1, 0
    while True:
        step, at, turn, shift = next_tied(
            block, seen, left, counts, reference, seed, step, here, rows
        )
        if at < 0:
            break
        joined[at], left[at] = True, False
        set_placement(R, t, at, turn, shift)
        place(here, R, t, at, placed)
        for i in range(n):
            counts[i] += seen[i, at]
            for a in range(d):
                sums[i, a] += placed[i, a] if seen[i, at] else 0.0
                reference[i, a] = sums[i, a] / max(counts[i], 1)
    leave_out(seen, joined)
    return joined, R, t


@helper
def leave_out(seen: Bools, joined: Bools) -> None:
    """Drop all observations (n, k) of iterations that are not joined (k,)."""
    for i in range(seen.shape[0]):
        for m in range(seen.shape[1]):
            seen[i, m] = seen[i, m] and joined[m]


@helper
def mean_of(block: Floats, seen: Bools, R: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean positions (n, d), their counts (n,), and all deviations (n, k, d)."""
    n, k, d = block.shape
    mean, counts, deviation = np.zeros((n, d)), np.zeros(n), np.zeros((n, k, d))
    for i in range(n):
        for m in range(k):
            if seen[i, m]:
                counts[i] += 1
                for a in range(d):
                    placed = t[m, a]
                    for b in range(d):
                        placed += R[m, a, b] * block[i, m, b]
                    deviation[i, m, a] = placed
                    mean[i, a] += placed
        for a in range(d):
            mean[i, a] /= max(counts[i], 1)
            for m in range(k):
                deviation[i, m, a] -= mean[i, a] if seen[i, m] else 0.0
    return mean, counts, deviation


@helper
def shared_of(block: Floats, seen: Bools) -> tuple[Ints, Ints, Floats, Ints]:
    """Return how many landmarks each iteration shares with others, which, and where; by iteration.

    (k,), (k, n) and (k, n, d); then the number of iterations that see each landmark (n,).
    """
    counts, shared = np.zeros(len(seen), dtype=np.int64), np.empty(seen.shape, dtype=np.bool_)
    for i in range(len(seen)):
        for m in range(seen.shape[1]):
            counts[i] += seen[i, m]
        for m in range(seen.shape[1]):
            shared[i, m] = seen[i, m] and counts[i] > 1
    n_of, of, here = by_iteration(block, shared)
    return n_of, of, here, counts


@helper
def _middle(
    here: Floats, n_of: Ints, of: Ints, counts: Ints, R: Floats, t: Floats, placed: Floats
) -> Floats:
    """Place the points of shared landmarks (k, n, d); return their means (n, d)."""
    mean = np.zeros((len(counts), here.shape[2]))
    for m in range(len(n_of)):
        place(here[m, : n_of[m]], R, t, m, placed[m])
        for j in range(n_of[m]):
            for a in range(here.shape[2]):
                mean[of[m, j], a] += placed[m, j, a]
    for i in range(len(counts)):
        for a in range(here.shape[2]):
            mean[i, a] /= max(counts[i], 1)
    return mean


@helper
def _enter_targets(
    here: Floats, of: Ints, placed: Floats, mean: Floats, square: float, means: Floats
) -> float:
    """Replace the places of points (c, d) by the means of their landmarks `of`.

    Returns the sum of squares so far plus that of the deviations, over c squared. Also writes the
    means (2, 3) of points and targets.
    """
    c, x, y, z, u, v, w = len(here), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(c):
        for a in range(here.shape[1]):
            square += ((placed[j, a] - mean[of[j], a]) / c) ** 2
            placed[j, a] = mean[of[j], a]
        x, y, u, v = x + here[j, 0], y + here[j, 1], u + placed[j, 0], v + placed[j, 1]
        if here.shape[1] == 3:
            z, w = z + here[j, 2], w + placed[j, 2]
    share = 1 / max(c, 1)
    means[0, 0], means[0, 1], means[0, 2] = x * share, y * share, z * share
    means[1, 0], means[1, 1], means[1, 2] = u * share, v * share, w * share
    return square


@helper
def settle(block: Floats, seen: Bools, joined: Bools, R: Floats, t: Floats) -> None:
    """Align the iterations of a segment jointly; R and t are updated in place.

    Each is fitted to the mean of all, alternately (generalised Procrustes analysis; Gower, 1975).
    """
    n, k, d = block.shape
    n_of, of, here, counts = shared_of(block, seen)
    placed, rows, means = np.empty((k, n, d)), np.empty(n, dtype=np.bool_), np.empty((2, 3))
    for i in range(n):
        rows[i] = True
    for _ in range(ROUNDS):
        mean, moved, square = _middle(here, n_of, of, counts, R, t, placed), 0.0, 0.0
        for m in range(k):
            if not joined[m]:
                continue
            c = n_of[m]
            own, there = here[m, :c], placed[m, :c]
            square = _enter_targets(own, of[m], there, mean, square, means)
            turn, shift, fixed, _ = fit_about(means, own, there, rows[:c], R[m].copy())
            if fixed:
                for a in range(d):
                    moved += (shift[a] - t[m, a]) ** 2
                set_placement(R, t, m, turn, shift)
        if moved <= STILL * STILL * square:
            break
