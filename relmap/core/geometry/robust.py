"""Fits and weights that a few wrong matches do not spoil."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import fit_rigid_each, place_each

OUTLIER = 7.0
"""Standard deviations beyond which a residual counts less: it is no noise."""
CHI_MEDIAN = {2: 1.177, 3: 1.538}
"""Median length of a standard normal vector."""
EXACT = 1e-9
"""Residual, as a share of the map's size, that is taken for rounding."""
ROUNDS = 8
"""Steps towards the least sum of distances: where one in five is wrong, each divides the error by
four."""


def limit_of(residual: Floats, dimension: int, size: float) -> float:
    """Return the residual beyond which noise explains none of residuals (n,).

    Parameters
    ----------
    residual : (n,) float64, metres
        Lengths, each in units of what the number of its observations makes it.
    dimension : int
        2 or 3.
    size : float
        Of the map, metres.
    """
    scale = float(np.median(residual)) / CHI_MEDIAN[dimension] if len(residual) else 0.0
    return max(OUTLIER * scale, EXACT * size, 1e-300)


def lenient(residual: Floats, limit: float) -> Floats:
    """Return weights (n,), 1 up to the limit, whose pull falls as Cauchy's with the distance.

    Huber's pull does not fall, and many wrong matches far off bend a long chain by metres.
    """
    return np.asarray((limit / np.maximum(residual, limit)) ** 2)


def strict(residual: Floats, limit: float) -> Floats:
    """Return weights (n,), 1 up to the limit, that leave what is far beyond it no say at all."""
    return lenient(residual, limit) ** 2


def robust_cost(residual: Floats, limit: float) -> float:
    """Return the cost of which the lenient weights make least squares."""
    outside = np.maximum(residual / limit, 1.0)
    return float(np.sum(np.minimum(residual, limit) ** 2 + 2 * limit**2 * np.log(outside)))


def fit_robust_each(
    source: Floats, target: Floats, counts: Floats, at: Ints, n: int
) -> tuple[Floats, Floats, Bools, Floats]:
    """Fit many sets of matched points as `fit_rigid_each` does, whatever a few of them say.

    The first fit is that of the least sum of distances (Weiszfeld, 1937); the last is by least
    squares, with weights for what is left of it.

    Parameters
    ----------
    source, target : (k, d) float64, metres
    counts : (k,) float64
        Observations behind each pair.
    at : (k,) int64
    n : int

    Returns
    -------
    R : (n, d, d) float64
    t : (n, d) float64
    fixed : (n,) bool
    weight : (k,) float64
        Of one observation; all 1 where noise explains everything.
    """
    size = float(np.ptp(target, axis=0).max()) if len(target) else 0.0
    least, root = max(EXACT * size, 1e-300), np.sqrt(counts)

    def apart() -> Floats:
        return np.asarray(np.linalg.norm(place_each(R, t, at, source) - target, axis=1))

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
