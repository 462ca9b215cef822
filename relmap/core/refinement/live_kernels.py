"""Moments of rigid bodies that share landmarks, compiled; see `live`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper


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
