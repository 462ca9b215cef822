"""Condensing a segment, compiled; see `relmap.core.refinement.condensing`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.geometry.fitting_kernels import centre_of, fit_rows, set_placement
from relmap.core.geometry.rotation_kernels import turned_by
from relmap.core.grouping.averaging_kernels import place
from relmap.core.linalg.compiling import compiled
from relmap.core.linalg.order_kernels import median
from relmap.core.linalg.small_kernels import diagonalise, factorise, identity, product, solve

LEVERAGE = 20.0
"""How many times as far as what ties an iteration to its segment its other points may lie."""
ROUNDS = 3
"""Gauss-Newton steps within a segment; each leaves about a hundredth of the error before it."""
OUTLIER = 10.0
"""Deviation of an observation, in medians of its segment, above which it is left out."""
EXACT = 1e-9
"""Deviation, as a share of the extent, that is taken for rounding."""


@compiled
def derivative(points: NDArray[np.float64], row: int, J: NDArray[np.float64]) -> None:
    """Enter the derivative (d, q) of a row of points (n, d) by a turn and shift of its frame."""
    J[:] = 0.0
    if points.shape[1] == 2:
        J[0, 0], J[1, 0] = -points[row, 1], points[row, 0]
        J[0, 1] = J[1, 2] = 1.0
    else:
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            J[a, b], J[a, c], J[a, a + 3] = points[row, c], -points[row, b], 1.0


@compiled
def _is_tied(
    here: NDArray[np.float64], rows: NDArray[np.bool_], scatter: NDArray[np.float64]
) -> bool:
    """Tell whether some rows of an iteration, NaN where it saw nothing, hold all of it firmly."""
    x, y, z, _ = centre_of(here, rows)
    across, farthest = scatter[0, 0] + scatter[1, 1], 0.0
    if here.shape[1] == 3:  # the middle one of the eigenvalues
        diagonalise(scatter)
        a, b, c = scatter[0, 0], scatter[1, 1], scatter[2, 2]
        across = max(min(a, b), min(max(a, b), c))
    for i in range(len(here)):
        square = (here[i, 0] - x) ** 2 + (here[i, 1] - y) ** 2
        square += (here[i, 2] - z) ** 2 if here.shape[1] == 3 else 0.0
        farthest = max(farthest, 0.0 if np.isnan(square) else square)
    return bool(farthest <= LEVERAGE * LEVERAGE * across)


@compiled
def join(
    block: NDArray[np.float64],
    seen: NDArray[np.bool_],
    free: NDArray[np.bool_],
    seed: int,
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Fit one iteration after another to those before, from the seed outwards, while they hold."""
    n, k, d = block.shape
    R, t, joined = np.zeros((k, d, d)), np.zeros((k, d)), np.zeros(k, dtype=np.bool_)
    placed, here, rows = np.empty((n, k, d)), np.empty((n, d)), np.zeros(n, dtype=np.bool_)
    sums, counts, reference = np.zeros((n, d)), np.zeros(n), np.zeros((n, d))
    again = True
    while again:
        again = False
        for step in range(2 * k):
            at = seed + (step + 1) // 2 * (1 if step % 2 else -1)
            if at < 0 or at >= k or joined[at] or not free[at]:
                continue
            n_rows = 0
            for i in range(n):
                rows[i] = seen[i, at] and counts[i] > 0
                n_rows += rows[i]
                for a in range(d):
                    here[i, a] = block[i, at, a]
            turn, shift, fixed, scatter = fit_rows(here, reference, rows, identity(d))
            if at != seed and not (n_rows >= d and fixed and _is_tied(here, rows, scatter)):
                continue
            joined[at] = again = True
            set_placement(R, t, at, turn, shift)
            place(here, R, t, at, placed)
            for i in range(n):
                counts[i] += seen[i, at]
                for a in range(d):
                    sums[i, a] += placed[i, at, a] if seen[i, at] else 0.0
                    reference[i, a] = sums[i, a] / max(counts[i], 1)
    return joined, R, t


@compiled
def _mean_of(
    block: NDArray[np.float64],
    seen: NDArray[np.bool_],
    R: NDArray[np.float64],
    t: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean places (n, d), their counts (n,), and all deviations (n, k, d)."""
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


@compiled
def _products(points: NDArray[np.float64], row: int, JJ: NDArray[np.float64]) -> None:
    """Enter J'J (q, q) of the derivative J of a row of points (n, d)."""
    d, q = points.shape[1], len(JJ)
    J = np.empty((d, q))
    derivative(points, row, J)
    for a in range(q):
        for b in range(q):
            JJ[a, b] = 0.0
            for c in range(d):
                JJ[a, b] += J[c, a] * J[c, b]


@compiled
def _normal_matrix(
    mean: NDArray[np.float64],
    counts: NDArray[np.float64],
    seen: NDArray[np.bool_],
    slots: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the matrix of the placements of some iterations, with the landmarks eliminated.

    Its lower half is filled.
    """
    n, d = mean.shape
    q = 3 * d - 3
    H, JJ = np.zeros((q * len(slots), q * len(slots))), np.empty((q, q))
    for i in range(n):
        _products(mean, i, JJ)
        for k in range(len(slots)):
            for m in range(k + 1):
                if seen[i, slots[k]] and seen[i, slots[m]] and counts[i] > 1:
                    share = (1.0 if k == m else 0.0) - 1 / counts[i]
                    for a in range(q):
                        for b in range(q):
                            H[q * k + a, q * m + b] += share * JJ[a, b]
    for a in range(len(H)):
        H[a, a] = H[a, a] * (1 + EXACT) + 1e-300
    return H


@compiled
def _pull(
    mean: NDArray[np.float64],
    deviation: NDArray[np.float64],
    slots: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the negative gradient of the sum of squares by the placements of some iterations."""
    n, d = mean.shape
    q = 3 * d - 3
    pull, J = np.zeros(q * len(slots)), np.empty((d, q))
    for i in range(n):
        derivative(mean, i, J)
        for k in range(len(slots)):
            for a in range(d):
                for b in range(q):
                    pull[q * k + b] -= J[a, b] * deviation[i, slots[k], a]
    return pull


@compiled
def _move(
    R: NDArray[np.float64], t: NDArray[np.float64], i: int, step: NDArray[np.float64]
) -> None:
    """Turn and shift the i-th placement by a step (q,)."""
    d = t.shape[1]
    by = turned_by(step[: len(step) - d])
    turn, shift = product(by, R[i]), np.empty(d)
    for a in range(d):
        shift[a] = step[len(step) - d + a]
        for b in range(d):
            shift[a] += by[a, b] * t[i, b]
    set_placement(R, t, i, turn, shift)


@compiled
def settle(
    block: NDArray[np.float64],
    seen: NDArray[np.bool_],
    slots: NDArray[np.int64],
    R: NDArray[np.float64],
    t: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Bring some iterations to where all of the segment agree best; R and t are changed."""
    q = 3 * t.shape[1] - 3
    H = np.empty((0, 0))
    for done in range(ROUNDS + 1):
        mean, counts, deviation = _mean_of(block, seen, R, t)
        if done == ROUNDS:
            break
        if done == 0:
            H = _normal_matrix(mean, counts, seen, slots)
            factorise(H)
        step = _pull(mean, deviation, slots)
        solve(H, step)
        for k in range(len(slots)):
            _move(R, t, slots[k], step[q * k : q * (k + 1)])
    return mean, counts, deviation


@compiled
def trim(
    deviation: NDArray[np.float64],
    mean: NDArray[np.float64],
    counts: NDArray[np.float64],
    seen: NDArray[np.bool_],
) -> bool:
    """Leave out the worst observation of each iteration, if it deviates too much; tell if any did.

    The others may deviate because of it.
    """
    n, k, d = deviation.shape
    squares, listed, n_listed, extent = np.zeros((n, k)), np.empty(n * k), 0, 0.0
    for i in range(n):
        square = 0.0
        for a in range(d):
            square += mean[i, a] * mean[i, a]
        extent = max(extent, square)
        for m in range(k):
            if seen[i, m] and counts[i] > 1:
                for a in range(d):
                    squares[i, m] += deviation[i, m, a] ** 2 / (1 - 1 / counts[i])
                listed[n_listed] = squares[i, m]
                n_listed += 1
    if n_listed == 0:
        return False
    limit, found = max(OUTLIER**2 * median(listed[:n_listed]), EXACT**2 * extent), False
    for m in range(k):
        worst = 0
        for i in range(n):
            worst = i if squares[i, m] > squares[worst, m] else worst
        if squares[worst, m] > limit:
            seen[worst, m] = False
            found = True
    return found
