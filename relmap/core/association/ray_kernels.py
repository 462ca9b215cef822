"""The variance of matches along and across the ray, compiled; see `metric`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.metric import CHI2_MEDIAN, LEAST, OUTLIER, RIDGE, ROUNDS, TINY
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import smallest
from relmap.core.linalg.small_kernels import factorise, solve


@compiled
def residuals(expected: Floats, found: Floats, n_seen: Ints, most: int) -> Floats:
    """Return the distance (n, 3) of each point (n, d), metres, and its squared residuals.

    Along and across the ray, of one observation: the prediction `expected` (n, d) averages those
    before, `n_seen` (n,), at most `most`.
    """
    (n, d), squares = found.shape, np.empty((len(found), 3))
    for i in range(n):
        square, along, whole = 0.0, 0.0, 0.0
        for a in range(d):
            square += found[i, a] * found[i, a]
        distance, spread = np.sqrt(square), np.sqrt(1 + 1 / min(n_seen[i], most))
        for a in range(d):
            off = (expected[i, a] - found[i, a]) / spread
            along += off * (found[i, a] / max(distance, 1e-12))
            whole += off * off
        squares[i, 0], squares[i, 1] = distance, along * along
        squares[i, 2] = max(whole - along * along, 0.0) / (d - 1)
    return squares


@helper
def _solved(moments: Floats, right: Floats, chosen: int, found: Floats) -> float:
    """Write the coefficients (t,) of some moments (t, t), 0 but for those of the bits of `chosen`.

    Returns by how much they reduce the squared residuals; -1 if one is negative.
    """
    used, n, gain = np.empty(len(right), dtype=np.int64), 0, 0.0
    for k in range(len(right)):
        found[k] = 0.0
        if chosen >> k & 1:
            used[n], n = k, n + 1
    root, x = np.empty((n, n)), np.empty(n)
    for i in range(n):
        x[i] = right[used[i]]
        for j in range(n):
            root[i, j] = moments[used[i], used[j]] * (1 + RIDGE if i == j else 1.0)
    factorise(root)
    solve(root, x)
    for i in range(n):
        found[used[i]] = x[i]
        gain = gain + x[i] * right[used[i]] if gain >= 0 and x[i] >= 0 else -1.0
    return gain


@helper
def fit(squares: Floats, column: int, unit_m: float, variance: Floats, found: Floats) -> None:
    """Write the coefficients (t,), 0 or more, of a column of squares (n, 3).

    Least squares weighted by variances (n,), with each set of coefficients above 0.
    """
    t = len(found)
    moments, right, term = np.zeros((t, t)), np.zeros(t), np.empty(t)
    for i in range(len(squares)):
        square = (squares[i, 0] / unit_m) ** 2
        clipped = min(squares[i, column], OUTLIER * variance[i]) / variance[i]
        term[0] = 1 / variance[i]
        for k in range(1, t):
            term[k] = square * term[k - 1]
        for k in range(t):
            right[k] += term[k] * clipped
            for j in range(t):
                moments[k, j] += term[k] * term[j]
    best = -1.0
    for chosen in range(1, 1 << t):
        gain = _solved(moments, right, chosen, term)
        if gain > best:
            best = gain
            for k in range(t):
                found[k] = term[k]


@compiled
def update(squares: Floats, unit_m: float, coefficients: Floats) -> None:
    """Update the coefficients (2, t) of the variances of residuals along and across the ray.

    `squares` (n, 3): the distance, metres, and the squared residuals along and across; `unit_m`:
    distance of which the coefficients are powers. Weighted, nonnegative least squares, from the
    coefficients before; outliers are clipped.
    """
    (n, t), variance = (len(squares), coefficients.shape[1]), np.empty(len(squares))
    for column in range(1, 3):
        found, before = coefficients[column - 1], 0.0
        for i in range(n):
            variance[i] = squares[i, column]
        typical = smallest(variance, n // 2) / CHI2_MEDIAN
        least = max(LEAST * typical, TINY)
        for k in range(t):
            before += found[k]
        for r in range(ROUNDS):
            for i in range(n):
                square, power, variance[i] = (squares[i, 0] / unit_m) ** 2, 1.0, 0.0
                for k in range(t):
                    variance[i] += found[k] * power
                    power *= square
                is_known = r > 0 or before > 0
                variance[i] = max(variance[i], least) if is_known else typical + least
            fit(squares, column, unit_m, variance, found)
