"""Placing rigid bodies that share landmarks by least squares, the landmarks eliminated."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import place_each, sums_each
from relmap.core.geometry.motions import derivatives, rotations
from relmap.core.refinement.equations import HOLD
from relmap.core.refinement.rows import rows_of_each


def brought_together(points: Floats, weight: Floats, landmark: Ints, body: Ints) -> Floats:
    """Return the points (n, d) of bodies after one Gauss-Newton step of their placements.

    A landmark is at the weighted mean of its points. The first body is fixed. Since Jacobians are
    linear in the points, sums of their products follow from second moments. A step that increases
    the cost is not taken: without noise it would follow rounding errors.

    `points` (n, d), map frame, metres; `weight` (n,); `landmark` (n,): 0 to m - 1; `body` (n,),
    ascending: 0 to b - 1.
    """
    from relmap.core.refinement.bodies_kernels import moments_between

    b, d, q = int(body[-1]) + 1, points.shape[1], 3 * points.shape[1] - 3
    centre = sums_each(points, body, b) / np.bincount(body)[:, None]
    away = points - centre[body]
    total = np.bincount(landmark, weights=weight).astype(np.float64)
    pull, cost = _pulls(points, weight, total, landmark)
    columns = np.column_stack([away, np.ones(len(away))])  # the Jacobians are linear in them
    constant = derivatives(np.zeros((1, d)))
    by_step = np.concatenate([derivatives(np.eye(d)) - constant, constant])
    force = _products(columns, pull, body)
    right = np.einsum("npa,pau->nu", force, by_step).ravel()
    moments = moments_between(columns, weight, body, *rows_of_each(landmark, len(total)), b)
    products = np.einsum("pau,qav->pquv", by_step, by_step).reshape((d + 1) ** 2, q * q)
    matrix = (moments.reshape(b * b, -1) @ products).reshape(b, b, q, q)
    matrix = matrix.swapaxes(1, 2).reshape(b * q, b * q)
    least = HOLD[1] + HOLD[0] * matrix.diagonal().max()
    free = matrix[q:, q:] + least * np.eye(b * q - q)
    steps = np.append(np.zeros(q), np.linalg.solve(free, right[q:])).reshape(b, q)
    after = place_each(rotations(steps[:, :-d]), steps[:, -d:], body, away) + centre[body]
    return after if _pulls(after, weight, total, landmark)[1] <= cost else points


def _pulls(points: Floats, weight: Floats, total: Floats, landmark: Ints) -> tuple[Floats, float]:
    """Return the weighted vectors (n, d) from points to the means of their landmarks.

    Also the cost: the weighted sum of the squared distances.
    """
    means = sums_each(weight[:, None] * points, landmark, len(total)) / total[:, None]
    apart = means[landmark] - points
    pull = weight[:, None] * apart
    return pull, float(np.sum(pull * apart))


def _products(x: Floats, y: Floats, body: Ints) -> Floats:
    """Return the sums (b, p, q) of the products of rows (n, p) and (n, q) of each body."""
    begin = np.searchsorted(body, np.arange(int(body[-1]) + 2)).tolist()
    return np.stack([x[i:j].T @ y[i:j] for i, j in pairwise(begin)])
