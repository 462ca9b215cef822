"""Placing rigid bodies that share landmarks by least squares, the landmarks eliminated."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import place_each, sums_each
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.refinement.equations import HOLD


def brought_together(points: Floats, weight: Floats, landmark: Ints, body: Ints) -> Floats:
    """Return the points (n, d) of bodies after one Gauss-Newton step of their placements.

    A landmark is at the weighted mean of its points. The first body is fixed. Since Jacobians are
    linear in the points, sums of their products follow from second moments.

    `points` (n, d), map frame, metres; `weight` (n,); `landmark` (n,): 0 to m - 1; `body` (n,),
    ascending: 0 to b - 1.
    """
    b, d, q = int(body[-1]) + 1, points.shape[1], 3 * points.shape[1] - 3
    begin = np.searchsorted(body, np.arange(b))
    centre = np.add.reduceat(points, begin) / np.bincount(body)[:, None]
    away = points - centre[body]
    total = np.bincount(landmark, weights=weight).astype(np.float64)
    means = sums_each(weight[:, None] * points, landmark, len(total)) / total[:, None]
    pull = (weight[:, None] * (means[landmark] - points)).T.copy()
    columns = np.vstack([away.T, np.ones(len(away))])  # of the Jacobians, linear combinations
    constant = derivatives(np.zeros((1, d)))
    by_step = np.concatenate([derivatives(np.eye(d)) - constant, constant])
    force = np.add.reduceat(columns[:, None] * pull, begin, axis=2)
    right = np.einsum("pan,pau->nu", force, by_step).ravel()
    products = np.einsum("pau,qav->pquv", by_step, by_step).reshape((d + 1) ** 2, q * q)
    moments = _moments(columns, weight, total, landmark, body, begin).reshape((d + 1) ** 2, b * b)
    matrix = (moments.T @ products).reshape(b, b, q, q).swapaxes(1, 2).reshape(b * q, b * q)
    least = HOLD[1] + HOLD[0] * matrix.diagonal().max()
    free = matrix[q:, q:] + least * np.eye(b * q - q)
    steps = np.append(np.zeros(q), np.linalg.solve(free, right[q:])).reshape(b, q)
    return place_each(rotations(steps[:, :-d]), steps[:, -d:], body, away) + centre[body]


def _moments(
    columns: Floats, weight: Floats, total: Floats, landmark: Ints, body: Ints, begin: Ints
) -> Floats:
    """Return second moments (q, q, b, b) of columns (q, n), by body, the landmarks eliminated."""
    q, b = len(columns), len(begin)
    one, other = _pairs(landmark)
    share = -weight[one] * weight[other] / total[landmark[one]]
    left, right, at = share * columns[:, one], columns[:, other], b * body[one] + body[other]
    between = [[np.bincount(at, x * y, b * b) for y in right] for x in left]
    half = np.array(between, dtype=np.float64).reshape(q, q, b, b)
    moments: Floats = half + half.transpose(1, 0, 3, 2)
    own = columns * (weight * (1 - weight / total[landmark]))
    each = np.arange(b)
    moments[:, :, each, each] += np.add.reduceat(own[:, None] * columns, begin, axis=2)
    return moments


def _pairs(landmark: Ints) -> tuple[Ints, Ints]:
    """Return the pairs of rows (k,), (k,) with the same landmark (n,)."""
    order = np.argsort(landmark, kind="stable")
    values, pairs = landmark[order], np.empty((2, 0), dtype=np.int64)
    for lag in range(1, len(order)):
        at = np.flatnonzero(values[lag:] == values[:-lag])
        if not len(at):
            break
        pairs = np.append(pairs, [order[at], order[at + lag]], axis=1)
    return pairs[0], pairs[1]
