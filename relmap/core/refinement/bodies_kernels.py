"""Moments of rigid bodies that share landmarks, compiled; see `bodies`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper


@helper
def _add_product(share: float, x: Floats, y: Floats, moment: Floats) -> None:
    """Add the weighted outer product of x and y (q,) to a moment (q, q)."""
    for a in range(len(x)):
        for c in range(len(y)):
            moment[a, c] += share * x[a] * y[c]


@compiled
def moments_between(
    columns: Floats, weight: Floats, body: Ints, begin: Ints, order: Ints, n_bodies: int
) -> Floats:
    """Return second moments (b, b, q, q) of rows (n, q) between bodies, the landmarks eliminated.

    `weight`, `body` (n,): of each row, the bodies ascending; `begin` (m + 1,), `order` (n,): the
    rows of each landmark, ascending, see `rows.rows_of_each`.
    """
    q = columns.shape[1]
    moments = np.zeros((n_bodies, n_bodies, q, q))
    for k in range(len(begin) - 1):
        own, total = order[begin[k] : begin[k + 1]], 0.0
        for i in own:
            total += weight[i]
        for r in range(len(own)):
            i = own[r]
            _add_product(weight[i], columns[i], columns[i], moments[body[i], body[i]])
            for j in own[: r + 1]:
                share = -weight[i] * weight[j] / total
                _add_product(share, columns[i], columns[j], moments[body[i], body[j]])
                if body[i] == body[j] and i != j:
                    _add_product(share, columns[j], columns[i], moments[body[i], body[j]])
    for k in range(n_bodies):
        for m in range(k):
            for a in range(q):
                for c in range(q):
                    moments[m, k, a, c] = moments[k, m, c, a]
    return moments
