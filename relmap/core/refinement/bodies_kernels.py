"""Moments of rigid bodies that share landmarks, compiled; see `bodies`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled


@compiled
def moments_between(
    columns: Floats, weight: Floats, total: Floats, landmark: Ints, body: Ints, n_bodies: int
) -> Floats:
    """Return second moments (b, b, q, q) of rows (n, q) between bodies, the landmarks eliminated.

    `weight`, `landmark`, `body` (n,): of each row, the bodies ascending; `total` (m,): sum of the
    weights of a landmark.
    """
    (n, q), n_landmarks = columns.shape, len(total)
    begin, order = np.zeros(n_landmarks + 1, dtype=np.int64), np.empty(n, dtype=np.int64)
    for i in range(n):
        begin[landmark[i] + 1] += 1
    for k in range(n_landmarks):
        begin[k + 1] += begin[k]
    at = begin.copy()
    for i in range(n):
        order[at[landmark[i]]], at[landmark[i]] = i, at[landmark[i]] + 1
    moments = np.zeros((n_bodies, n_bodies, q, q))
    for k in range(n_landmarks):
        for r in range(begin[k], begin[k + 1]):
            i = order[r]
            for s in range(begin[k], r + 1):
                j = order[s]
                share = (weight[i] if i == j else 0.0) - weight[i] * weight[j] / total[k]
                is_twice = body[i] == body[j] and i != j
                for a in range(q):
                    factor = share * columns[i, a]
                    for c in range(q):
                        moments[body[i], body[j], a, c] += factor * columns[j, c]
                        if is_twice:
                            moments[body[i], body[j], c, a] += factor * columns[j, c]
    for k in range(n_bodies):
        for m in range(k):
            for a in range(q):
                for c in range(q):
                    moments[m, k, c, a] = moments[k, m, a, c]
    return moments


@compiled
def pulls(points: Floats, weight: Floats, total: Floats, landmark: Ints) -> tuple[Floats, float]:
    """Return the weighted vectors (n, d) from points to the means of their landmarks.

    Also the cost: the weighted sum of the squared distances.
    """
    (n, d), cost = points.shape, 0.0
    means, pull = np.zeros((len(total), d)), np.empty((n, d))
    for i in range(n):
        for a in range(d):
            means[landmark[i], a] += weight[i] * points[i, a]
    for k in range(len(total)):
        for a in range(d):
            means[k, a] /= total[k]
    for i in range(n):
        for a in range(d):
            apart = means[landmark[i], a] - points[i, a]
            pull[i, a] = weight[i] * apart
            cost += pull[i, a] * apart
    return pull, cost
