"""The hot loops of condensing and refining, compiled; see `kernels` on how and why."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled
from relmap.core.kernels.fitting import fit_rows

LEVERAGE = 20.0
"""How many times as far as what ties an iteration to its segment its other points may lie."""
ROUNDS = 3
"""Gauss-Newton steps within a segment; each leaves about a hundredth of the error before it."""
TRIMS = 3
"""How often outliers are looked for."""
OUTLIER = 10.0
"""Deviation of an observation, in medians of its segment, above which it is left out."""
EXACT = 1e-9
"""Deviation, as a share of the extent, that is taken for rounding."""


@compiled
def derivative(point: NDArray[np.float64], J: NDArray[np.float64]) -> None:
    """Enter the derivative (d, q) of a point (d,) by a small turn and shift of its frame."""
    J[:] = 0.0
    if len(point) == 2:
        J[0, 0], J[1, 0] = -point[1], point[0]
        J[0, 1] = J[1, 2] = 1.0
    else:
        J[0, 1], J[0, 2] = point[2], -point[1]
        J[1, 0], J[1, 2] = -point[2], point[0]
        J[2, 0], J[2, 1] = point[1], -point[0]
        J[0, 3] = J[1, 4] = J[2, 5] = 1.0


@compiled
def turned_by(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (d, d) by a rotation vector (1,) or (3,) (Rodrigues)."""
    if len(turn) == 1:
        c, s = np.cos(turn[0]), np.sin(turn[0])
        return np.array([[c, -s], [s, c]])
    x, y, z = turn
    angle = np.sqrt(x * x + y * y + z * z)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    small = angle < 1e-9
    a = 1.0 if small else np.sin(angle) / angle
    b = 0.5 if small else (1 - np.cos(angle)) / angle**2
    R: NDArray[np.float64] = np.eye(3) + a * cross + b * np.dot(cross, cross)
    return R


@compiled
def _place(
    here: NDArray[np.float64], R: NDArray[np.float64], t: NDArray[np.float64], i: int
) -> NDArray[np.float64]:
    d = len(t)
    placed = np.empty(d)
    for a in range(d):
        placed[a] = t[a]
        for b in range(d):
            placed[a] += R[a, b] * here[i, b]
    return placed


@compiled
def _is_tied(
    here: NDArray[np.float64],
    seen: NDArray[np.bool_],
    rows: NDArray[np.bool_],
    scatter: NDArray[np.float64],
) -> bool:
    """Tell whether some rows of an iteration hold all of it firmly."""
    n, d = here.shape
    spread = np.linalg.eigvalsh(scatter)
    across = np.sqrt(spread[1] if d == 3 else spread[1] + spread[0])
    middle, count = np.zeros(d), rows.sum()
    for i in range(n):
        if rows[i]:
            middle += here[i] / count
    reach = 0.0
    for i in range(n):
        if seen[i]:
            reach = max(reach, np.sqrt(np.sum((here[i] - middle) ** 2)))
    return bool(reach <= LEVERAGE * across)


@compiled
def _join(
    block: NDArray[np.float64],
    seen: NDArray[np.bool_],
    free: NDArray[np.bool_],
    seed: int,
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Fit one iteration after another to those before, from the seed outwards, while they hold."""
    n, k, d = block.shape
    R, t = np.zeros((k, d, d)), np.zeros((k, d))
    joined = np.zeros(k, dtype=np.bool_)
    sums, counts = np.zeros((n, d)), np.zeros(n)
    reference = np.zeros((n, d))
    again = True
    while again:
        again = False
        for step in range(2 * k):
            at = seed + (step + 1) // 2 * (1 if step % 2 else -1)
            if at < 0 or at >= k or joined[at] or not free[at]:
                continue
            here = np.ascontiguousarray(block[:, at, :])
            if at == seed:
                R[at] = np.eye(d)
            else:
                rows = seen[:, at] & (counts > 0)
                if rows.sum() < d:
                    continue
                turn, shift, fixed, scatter = fit_rows(here, reference, rows, np.eye(here.shape[1]))
                if not fixed or not _is_tied(here, seen[:, at], rows, scatter):
                    continue
                R[at], t[at] = turn, shift
            joined[at] = again = True
            for i in range(n):
                if seen[i, at]:
                    sums[i] += _place(here, R[at], t[at], i)
                    counts[i] += 1
                    reference[i] = sums[i] / counts[i]
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
                for a in range(d):
                    placed = t[m, a]
                    for b in range(d):
                        placed += R[m, a, b] * block[i, m, b]
                    deviation[i, m, a] = placed
                    mean[i, a] += placed
                counts[i] += 1
        if counts[i] > 0:
            mean[i] /= counts[i]
        for m in range(k):
            if seen[i, m]:
                for a in range(d):
                    deviation[i, m, a] -= mean[i, a]
    return mean, counts, deviation


@compiled
def _products(mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return J'J (n, q, q) of the derivatives of places (n, d)."""
    n, d = mean.shape
    q = 3 if d == 2 else 6
    products, J = np.zeros((n, q, q)), np.empty((d, q))
    for i in range(n):
        derivative(mean[i], J)
        for a in range(q):
            for b in range(q):
                for c in range(d):
                    products[i, a, b] += J[c, a] * J[c, b]
    return products


@compiled
def _normal_matrix(
    products: NDArray[np.float64],
    counts: NDArray[np.float64],
    seen: NDArray[np.bool_],
    slots: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the matrix of the placements of some iterations, with the landmarks eliminated."""
    q = products.shape[1]
    H = np.zeros((q * len(slots), q * len(slots)))
    for k in range(len(slots)):
        for other in range(k + 1):
            block = np.zeros((q, q))
            for i in range(len(counts)):
                if seen[i, slots[k]] and seen[i, slots[other]] and counts[i] > 1:
                    block += ((1.0 if k == other else 0.0) - 1 / counts[i]) * products[i]
            H[q * k : q * (k + 1), q * other : q * (other + 1)] = block
            H[q * other : q * (other + 1), q * k : q * (k + 1)] = block.T
    for a in range(len(H)):
        H[a, a] = H[a, a] * (1 + EXACT) + 1e-300
    return H


@compiled
def _pull(
    mean: NDArray[np.float64],
    deviation: NDArray[np.float64],
    seen: NDArray[np.bool_],
    slots: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the gradient of the sum of squares by the placements of some iterations."""
    n, d = mean.shape
    q = 3 if d == 2 else 6
    gradient, J = np.zeros(q * len(slots)), np.empty((d, q))
    for i in range(n):
        derivative(mean[i], J)
        for k in range(len(slots)):
            if seen[i, slots[k]]:
                for b in range(q):
                    for a in range(d):
                        gradient[q * k + b] += J[a, b] * deviation[i, slots[k], a]
    return gradient


@compiled
def _settle(
    block: NDArray[np.float64],
    seen: NDArray[np.bool_],
    slots: NDArray[np.int64],
    R: NDArray[np.float64],
    t: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Bring some iterations to where all of the segment agree best; R and t are changed."""
    d = t.shape[1]
    q = 3 if d == 2 else 6
    mean, counts, deviation = _mean_of(block, seen, R, t)
    if len(slots) == 0:
        return mean, counts, deviation
    inverse = np.linalg.inv(_normal_matrix(_products(mean), counts, seen, slots))
    for _ in range(ROUNDS):
        step = -np.dot(inverse, _pull(mean, deviation, seen, slots))
        for k in range(len(slots)):
            turn = turned_by(step[q * k : q * (k + 1) - d])
            R[slots[k]] = np.dot(turn, R[slots[k]])
            t[slots[k]] = np.dot(turn, t[slots[k]]) + step[q * (k + 1) - d : q * (k + 1)]
        mean, counts, deviation = _mean_of(block, seen, R, t)
    return mean, counts, deviation


@compiled
def _trim(
    deviation: NDArray[np.float64],
    mean: NDArray[np.float64],
    counts: NDArray[np.float64],
    seen: NDArray[np.bool_],
) -> bool:
    """Leave out the worst observation of each iteration, if it deviates too much; tell if any did.

    The others may deviate because of it.
    """
    n, k, _ = deviation.shape
    squares = np.zeros((n, k))
    n_squares = 0
    listed = np.empty(n * k)
    extent = 0.0
    for i in range(n):
        if counts[i] > 0:
            extent = max(extent, np.sum(mean[i] ** 2))
        if counts[i] < 2:
            continue
        for m in range(k):
            if seen[i, m]:
                squares[i, m] = np.sum(deviation[i, m] ** 2) / (1 - 1 / counts[i])
                listed[n_squares] = squares[i, m]
                n_squares += 1
    if n_squares == 0:
        return False
    middle = np.median(listed[:n_squares])
    limit = max(OUTLIER**2 * middle, EXACT**2 * extent)
    found = False
    for m in range(k):
        worst = np.argmax(squares[:, m])
        if squares[worst, m] > limit:
            seen[worst, m] = False
            found = True
    return found


@compiled
def condense_block(
    block: NDArray[np.float64], free: NDArray[np.bool_]
) -> tuple[
    NDArray[np.bool_],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.uint8],
    float,
]:
    """Condense as many iterations of a block (n, k, d) as hold together; see `condensing`.

    Returns which of the free iterations (k,) are in the segment, where they lie in it, R (k, d, d)
    and t (k, d), the places (n, d) and visibility (n,) of the landmarks, bit m for iteration m, and
    the sum of the squared deviations from these places.
    """
    k = block.shape[1]
    seen = (block[:, :, 0] == block[:, :, 0]) & free  # NaN is not itself
    seed = int(np.argmax(seen.sum(axis=0)))
    joined, R, t = _join(block, seen, free, seed)
    seen &= joined
    slots = np.array([m for m in range(k) if joined[m] and m != seed], dtype=np.int64)
    mean, counts, deviation = _settle(block, seen, slots, R, t)
    for _ in range(TRIMS):
        if not _trim(deviation, mean, counts, seen):
            break
        mean, counts, deviation = _settle(block, seen, slots, R, t)
    mask = np.zeros(len(seen), dtype=np.uint8)
    for m in range(k):
        mask |= seen[:, m].astype(np.uint8) << np.uint8(m)
    return joined, R, t, mean, mask, np.sum(deviation**2)
