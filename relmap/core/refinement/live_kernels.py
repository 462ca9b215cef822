"""Moments of rigid bodies that share landmarks, compiled; see `live`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import unset


@compiled
def united(listed: Ints, order: Ints, n: int) -> tuple[Ints, Ints, Ints]:
    """Return the distinct landmarks (m,) of two lists, one after the other, and where they are.

    `listed` (k,): the first list has n entries; `order` (k,): they ascend in this stable order.
    Then follow which landmark each entry is (k,), and the last entry in each list (2, s) of those
    in both.
    """
    k, m, s = len(listed), 0, 0
    landmark, of, both = np.empty(k, dtype=np.int64), np.empty(k, dtype=np.int64), unset(2 * k)
    for j in range(k):
        i = order[j]
        if j == 0 or listed[i] != landmark[m - 1]:
            s += m > 0 and both[s] >= 0 and both[k + s] >= 0
            both[s] = both[k + s] = -1
            landmark[m], m = listed[i], m + 1
        of[i] = m - 1
        both[s if i < n else k + s] = i
    s += m > 0 and both[s] >= 0 and both[k + s] >= 0
    return landmark[:m], of, both.reshape((2, k))[:, :s]


@compiled
def averages(points: Floats, weight: Floats, of: Ints, n: int) -> tuple[Floats, Floats]:
    """Return weighted means (n, d) of points (k, d) by set `of` (k,), and total weights (n,)."""
    means, total = np.zeros((n, points.shape[1])), np.zeros(n)
    for i in range(len(points)):
        total[of[i]] += weight[i]
        for a in range(points.shape[1]):
            means[of[i], a] += weight[i] * points[i, a]
    for k in range(n):
        for a in range(points.shape[1]):
            means[k, a] /= total[k]
    return means, total


@helper
def _add_product(
    columns: Floats, i: int, j: int, share: float, moments: Floats, body: Ints
) -> None:
    """Add the product of two rows (n, q), times a share, to the moment of their bodies."""
    for a in range(columns.shape[1]):
        for c in range(columns.shape[1]):
            moments[body[i], body[j], a, c] += share * columns[i, a] * columns[j, c]


@compiled
def moments_between(
    columns: Floats, weight: Floats, body: Ints, begin: Ints, order: Ints, n_bodies: int
) -> Floats:
    """Return second moments (b, b, q, q) of rows (n, q) between bodies, the landmarks eliminated.

    `weight`, `body` (n,): of each row. The rows of each landmark are ``order[begin[k] : begin[k +
    1]]``; `order` (n,), `begin` (m + 1,).
    """
    q = columns.shape[1]
    moments = np.zeros((n_bodies, n_bodies, q, q))
    for k in range(len(begin) - 1):
        total = 0.0
        for r in range(begin[k], begin[k + 1]):
            total += weight[order[r]]
        for r in range(begin[k], begin[k + 1]):
            i = order[r]
            for s in range(begin[k], begin[k + 1]):
                j = order[s]
                share = weight[i] * ((1.0 if r == s else 0.0) - weight[j] / total)
                if body[j] <= body[i]:
                    _add_product(columns, i, j, share, moments, body)
    for one in range(n_bodies):
        for other in range(one):
            for a in range(q):
                for c in range(q):
                    moments[other, one, c, a] = moments[one, other, a, c]
    return moments
