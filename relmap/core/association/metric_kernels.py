"""The fit of variances with nonnegative coefficients, compiled; see `metric`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import factorise, solve

HELD = 1e-12
"""Relative increase of the diagonal, for terms that are nearly proportional."""


@helper
def _nonnegative(A: Floats, b: Floats) -> Floats:
    """Return the nonnegative x (k,) of least x'Ax - 2 b'x, by trying every set of positive entries.

    For a few unknowns this is faster than an active-set method.
    """
    k, least = len(b), 0.0
    best = np.zeros(k)
    for chosen in range(1, 1 << k):
        x, own = np.zeros(k), np.zeros((k, k))
        for i in range(k):
            own[i, i] = 1.0
            if chosen >> i & 1:
                x[i] = b[i]
                for j in range(k):
                    own[i, j] = A[i, j] if chosen >> j & 1 else 0.0
                own[i, i] *= 1 + HELD
        factorise(own)
        solve(own, x)
        cost, is_valid = 0.0, True
        for i in range(k):
            is_valid &= x[i] >= 0
            cost -= b[i] * x[i]
        if is_valid and cost < least:
            best, least = x, cost
    return best


@compiled
def fitted(
    terms: Floats, squares: Floats, before: Floats, limits: tuple[float, float, float], rounds: int
) -> Floats:
    """Return coefficients (k,) such that the terms (n, k) give the expected squares (n,).

    Each square is weighted by its variance, first by the coefficients before; all 0 if unknown.
    `limits`: of squares in variances, of a variance, and the typical variance.
    """
    outlier, least, typical = limits
    n, k = terms.shape
    found, is_known = before.copy(), False
    for a in range(k):
        is_known |= before[a] != 0
    for _ in range(rounds):
        A, b = np.zeros((k, k)), np.zeros(k)
        for i in range(n):
            variance = 0.0
            for a in range(k):
                variance += terms[i, a] * found[a]
            variance = max(variance, least) if is_known else typical + least
            square, weight = min(squares[i], outlier * variance), 1 / (variance * variance)
            for a in range(k):
                term = weight * terms[i, a]
                b[a] += term * square
                for c in range(a + 1):
                    A[a, c] += term * terms[i, c]
        for a in range(k):
            for c in range(a):
                A[c, a] = A[a, c]
        found, is_known = _nonnegative(A, b), True
    return found
