"""Weighted rigid fits, compiled; see `alignment` and `robust`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.fitting_kernels import scatter_of, swings_of
from relmap.core.geometry.rotation_kernels import best_rotation, fixes
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import median
from relmap.core.linalg.small_kernels import identity


@helper
def _weighted_fit(
    source: Floats, target: Floats, weights: Floats, guess: Floats
) -> tuple[Floats, Floats, bool]:
    """Fit matched points (n, d) rigidly with weights (n,), none of all 0, as `fit_rigid` does.

    Returns R, t, and whether the source determines R. An initial guess of R (d, d) saves time.
    """
    (n, d), total = source.shape, 0.0
    means, moment, scatter = np.zeros((2, d)), np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(n):
        total += weights[i]
        for a in range(d):
            means[0, a] += weights[i] * source[i, a]
            means[1, a] += weights[i] * target[i, a]
    for a in range(d):
        means[0, a], means[1, a] = means[0, a] / total, means[1, a] / total
    for i in range(n):
        for a in range(d):
            away = weights[i] / total * (source[i, a] - means[0, a])
            for b in range(d):
                moment[a, b] += away * (target[i, b] - means[1, b])
                scatter[a, b] += away * (source[i, b] - means[0, b])
    R, t = best_rotation(moment, guess), means[1].copy()
    for a in range(d):
        for b in range(d):
            t[a] -= R[a, b] * means[0, b]
    return R, t, fixes(scatter, d)


@helper
def _place(points: Floats, R: Floats, t: Floats, placed: Floats) -> None:
    """Write points (n, d) transformed by R (d, d) and t (d,)."""
    n, d = points.shape
    for i in range(n):
        for a in range(d):
            placed[i, a] = t[a]
            for b in range(d):
                placed[i, a] += R[a, b] * points[i, b]


@compiled
def aligned(points: Floats, there: Floats, weights: Floats, loose: float) -> tuple[Floats, bool]:
    """Fit points (n, d) to places (n, d), with weights (n,), 0 where there is none; place all.

    Returns the placed points, NaN where the variance relative to that of the points fitted to
    exceeds `loose`, and whether the places determine the rotation.
    """
    (n, d), k = points.shape, 0
    rows, placed = np.empty(n, dtype=np.bool_), np.empty((n, d))
    source, target, weight = np.empty((n, d)), np.empty((n, d)), np.empty(n)
    for i in range(n):
        rows[i] = weights[i] > 0
        if rows[i]:
            for a in range(d):
                source[k, a], target[k, a] = points[i, a], there[i, a]
            weight[k], k = weights[i], k + 1
    if k < d or not fixes(scatter_of(there, rows), d):
        return placed, False
    R, t, _ = _weighted_fit(source[:k], target[:k], weight[:k], identity(d))
    _place(points, R, t, placed)
    swing = swings_of(points, rows)
    for i in range(n):
        if not swing[i] <= loose:
            for a in range(d):
                placed[i, a] = np.nan
    return placed, True


@helper
def _residuals(placed: Floats, target: Floats, residual: Floats) -> None:
    """Write the distances (n,) of placed points (n, d) from their targets."""
    for i in range(len(residual)):
        square = 0.0
        for a in range(placed.shape[1]):
            square += (placed[i, a] - target[i, a]) ** 2
        residual[i] = np.sqrt(square)


@helper
def _lenient(residual: Floats, counts: Floats, scale: tuple[float, float], weight: Floats) -> bool:
    """Write the lenient weights (n,) of residuals; return whether all are 1."""
    outlier, exact_m = scale
    listed, all_one = np.empty(len(residual)), True
    for i in range(len(residual)):
        listed[i] = np.sqrt(counts[i]) * residual[i]
    limit = max(outlier * median(listed), exact_m, 1e-300)
    for i in range(len(residual)):
        weight[i] = (limit / max(np.sqrt(counts[i]) * residual[i], limit)) ** 2
        all_one &= weight[i] == 1
    return all_one


@compiled
def robust_fit(
    source: Floats, target: Floats, counts: Floats, outlier: float, exact: float, rounds: int
) -> tuple[Floats, Floats, bool]:
    """Fit one set of matched points (n, d) as `robust.fit_robust_each` fits many.

    `outlier`: the largest residual of an inlier, relative to the median; `exact`: rounding relative
    to the extent. Returns R, t and whether they are determined.
    """
    (n, d), extent = source.shape, 0.0
    residual, weight, placed = np.empty(n), np.empty(n), np.empty((n, d))
    for a in range(d):
        low, high = np.inf, -np.inf
        for i in range(n):
            low, high = min(low, target[i, a]), max(high, target[i, a])
        extent = max(extent, high - low)
    scale = outlier, exact * extent
    R, t, fixed = _weighted_fit(source, target, counts, identity(d))
    for k in range(rounds + 1):
        _place(source, R, t, placed)
        _residuals(placed, target, residual)
        if k in (0, rounds) and _lenient(residual, counts, scale, weight):
            break
        if k < rounds:
            for i in range(n):
                weight[i] = 1 / max(residual[i], exact * extent, 1e-300)
        for i in range(n):
            weight[i] *= counts[i]
        R, t, _ = _weighted_fit(source, target, weight, R)
    return R, t, fixed
