"""Robust fits, weights and medians."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import extent_of, fit_rigid_each

OUTLIER = 7.0
"""Standard deviations beyond which a residual is down-weighted as an outlier."""
CHI_MEDIAN = {2: 1.177, 3: 1.538}
"""Median length of a standard normal vector."""
EXACT = 1e-9
"""Residual, as a fraction of the map's size, treated as rounding."""
MANY = 1000
"""Values from which numpy's median is faster."""
ROUNDS = 8
"""Iterations towards the least sum of distances: with one outlier in five, each divides the error
by four."""


def median(values: Floats) -> float:
    """Return the median of values (n,), at least one; for a few hundred a fifth of numpy's time."""
    ordered, n = np.sort(values), len(values)
    return float(ordered[(n - 1) // 2] + ordered[n // 2]) / 2


def limit_of(residual: Floats, dimension: int, size: float) -> float:
    """Return the largest of residuals (n,) that noise explains.

    `residual` (n,), metres: lengths, each normalised by its number of observations; `dimension`: 2
    or 3; `size`: size of the map, metres.
    """
    middle = median if len(residual) < MANY else np.median
    scale = float(middle(residual)) / CHI_MEDIAN[dimension] if len(residual) else 0.0
    return max(OUTLIER * scale, EXACT * size, 1e-300)


def huber(residual: Floats, limit: float) -> Floats:
    """Return weights (n,), 1 up to the limit, of constant influence beyond it (Huber, 1964).

    A chain whose loop closes metres off bends under them. If the influence decreases, it tears at
    its weakest link instead.
    """
    return np.asarray(limit / np.maximum(residual, limit))


def lenient(residual: Floats, limit: float) -> Floats:
    """Return weights (n,), 1 up to the limit, beyond it Cauchy weights.

    The influence of Huber weights does not decrease, and many distant wrong matches bend a long
    chain by metres.
    """
    return np.asarray((limit / np.maximum(residual, limit)) ** 2)


def strict(residual: Floats, limit: float) -> Floats:
    """Return weights (n,), 1 up to the limit, that drop to zero far beyond it."""
    return lenient(residual, limit) ** 2


def robust_cost(residual: Floats, limit: float) -> float:
    """Return the cost function that corresponds to the lenient weights."""
    outside = np.maximum(residual / limit, 1.0)
    return float(np.sum(np.minimum(residual, limit) ** 2 + 2 * limit**2 * np.log(outside)))


def bounded_cost(residual: Floats, limit: float) -> float:
    """Return the cost function that corresponds to the strict weights.

    It hardly depends on how far off an outlier is. `robust_cost` grows with the distance, so with
    many outliers it may prefer a wrong map to which they are a little closer.
    """
    outside = np.maximum(residual / limit, 1.0)
    return float(np.sum(np.minimum(residual, limit) ** 2 + limit**2 * (1 - outside**-2)))


def fit_robust_each(
    source: Floats, target: Floats, counts: Floats, at: Ints, n: int
) -> tuple[Floats, Floats, Bools, Floats]:
    """Fit many sets of matched points as `fit_rigid_each` does, robust to a few outliers.

    The first fit minimises the sum of distances (Weiszfeld, 1937); the last is weighted least
    squares, with weights from the residuals of the first.

    `source`, `target` (k, d), metres; `counts` (k,): observations behind each pair; `at` (k,).
    Returns `R` (n, d, d); `t` (n, d); `fixed` (n,); `weight` (k,): weight of one observation; 1 if
    noise explains all residuals.
    """
    import relmap.core.geometry.each_kernels as kernels

    source, target = np.ascontiguousarray(source), np.ascontiguousarray(target)
    at = np.ascontiguousarray(at)
    size = extent_of(target)
    least, root = max(EXACT * size, 1e-300), np.sqrt(counts)

    def apart() -> Floats:
        return kernels.misfits_each(R, t, at, source, target)

    def weights() -> Floats:
        residual = root * apart()
        return lenient(residual, limit_of(residual[fixed[at]], source.shape[1], size))

    R, t, fixed = fit_rigid_each(source, target, counts, at, n)
    weight = weights()
    if (weight == 1).all():
        return R, t, fixed, weight
    for _ in range(ROUNDS):
        R, t, _ = fit_rigid_each(source, target, counts / np.maximum(apart(), least), at, n)
    weight = weights()
    R, t, _ = fit_rigid_each(source, target, counts * weight, at, n)
    return R, t, fixed, weight
