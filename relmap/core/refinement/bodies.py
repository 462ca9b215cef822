"""Placing rigid bodies that share landmarks by least squares, the landmarks eliminated."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import place_each, sums_each
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.refinement.equations import HOLD


def brought_together(points: Floats, weight: Floats, landmark: Ints, body: Ints) -> Floats:
    """Return the points (n, d) of bodies after one Gauss-Newton step of their placements.

    A landmark is at the weighted mean of its points. The first body is fixed. Since Jacobians are
    linear in the points, sums of their products follow from second moments. A step that increases
    the cost is not taken: without noise it would follow rounding errors.

    `points` (n, d), map frame, metres; `weight` (n,); `landmark` (n,): 0 to m - 1; `body` (n,),
    ascending: 0 to b - 1.
    """
    b, d, q = int(body[-1]) + 1, points.shape[1], 3 * points.shape[1] - 3
    begin = np.searchsorted(body, np.arange(b))
    centre = np.add.reduceat(points, begin) / np.bincount(body)[:, None]
    away = points - centre[body]
    total = np.bincount(landmark, weights=weight).astype(np.float64)
    pull = _pull(points, weight, total, landmark)
    columns = np.vstack([away.T, np.ones(len(away))])  # of the Jacobians, linear combinations
    constant = derivatives(np.zeros((1, d)))
    by_step = np.concatenate([derivatives(np.eye(d)) - constant, constant])
    force = np.add.reduceat(columns[:, None] * (weight * pull), begin, axis=2)
    right = np.einsum("pan,pau->nu", force, by_step).ravel()
    products = np.einsum("pau,qav->pquv", by_step, by_step).reshape((d + 1) ** 2, q * q)
    moments = _moments(columns, weight, total, landmark, body, begin).reshape((d + 1) ** 2, b * b)
    matrix = (moments.T @ products).reshape(b, b, q, q).swapaxes(1, 2).reshape(b * q, b * q)
    least = HOLD[1] + HOLD[0] * matrix.diagonal().max()
    free = matrix[q:, q:] + least * np.eye(b * q - q)
    steps = np.append(np.zeros(q), np.linalg.solve(free, right[q:])).reshape(b, q)
    after = place_each(rotations(steps[:, :-d]), steps[:, -d:], body, away) + centre[body]
    costs = [(weight * _pull(each, weight, total, landmark) ** 2).sum() for each in (points, after)]
    return after if costs[1] <= costs[0] else points


def _pull(points: Floats, weight: Floats, total: Floats, landmark: Ints) -> Floats:
    """Return the vectors (d, n) from points to the means of their landmarks."""
    means = sums_each(weight[:, None] * points, landmark, len(total)) / total[:, None]
    return np.ascontiguousarray((means[landmark] - points).T)


def _moments(
    columns: Floats, weight: Floats, total: Floats, landmark: Ints, body: Ints, begin: Ints
) -> Floats:
    """Return second moments (q, q, b, b) of columns (q, n), by body, the landmarks eliminated."""
    q, b = len(columns), len(begin)
    rows = (np.arange(q)[:, None] * b + body).ravel(), np.tile(landmark, q)
    own = weight * columns
    left, right = (
        sparse.csr_array((each.ravel(), rows), shape=(q * b, len(total)))
        for each in (own / total[landmark], own)
    )
    between = (left @ right.T).toarray().reshape(q, b, q, b)
    moments: Floats = -between.swapaxes(1, 2)
    each = np.arange(b)
    moments[:, :, each, each] += np.add.reduceat(own[:, None] * columns, begin, axis=2)
    return moments
