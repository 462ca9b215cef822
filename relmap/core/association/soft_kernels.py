"""Likelihood of placements, compiled; see `soft`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import square_between


@helper
def _placed(points: Floats, R: Floats, t: Floats) -> Floats:
    """Return points (n, d) after placement."""
    n, d = points.shape
    placed = np.empty((n, d))
    for i in range(n):
        for a in range(d):
            placed[i, a] = t[a]
            for b in range(d):
                placed[i, a] += R[a, b] * points[i, b]
    return placed


@compiled
def soft_matches(
    source: Floats,
    variance: Floats,
    target: Floats,
    density: float,
    unexplained: float,
    furthest: float,
    R: Floats,
    t: Floats,
    share: Floats,
    metric: Floats | None = None,
    peak: Floats | None = None,
) -> float:
    """Write the probability that each target (m, d) belongs to each placed source point (n, d).

    Parameters
    ----------
    source, target : (n, d), (m, d) float64, metres
    variance : (n,) float64, square metres
        Of the difference of a coordinate between a source point and the target of the same object.
    density : float
        Targets of other objects per unit of area or volume.
    unexplained : float
        Fraction of the targets that belong to other objects.
    furthest : float
        Largest squared distance of a match, in variances.
    R, t : (d, d), (d,) float64
    share : (n, m) float64
        Overwritten with the probabilities.
    metric : (m, d, d) float64, optional
        Of the targets.
    peak : (m,) float64, optional
        Its determinants.

    Returns
    -------
    float
        Log likelihood ratio, relative to targets that all belong to other objects.
    """
    (n, d), m = source.shape, len(target)
    placed, apart, score = _placed(source, R, t), np.empty(d), 0.0
    for j in range(m):
        total = 0.0
        for i in range(n):
            share[i, j] = 0.0
            square = square_between(target[j], placed[i], metric, j, apart) / variance[i]
            if square < furthest:
                share[i, j] = np.exp(-square / 2) / (2 * np.pi * variance[i]) ** (d / 2)
                if peak is not None:
                    share[i, j] *= peak[j]
                total += share[i, j]
        total *= 1 - unexplained
        score += np.log(unexplained + total / density)
        for i in range(n):
            share[i, j] *= (1 - unexplained) / (total + unexplained * density)
    return score


@compiled
def scores(
    source: Floats,
    variance: Floats,
    target: Floats,
    density: float,
    unexplained: float,
    furthest: float,
    R: Floats,
    t: Floats,
    metric: Floats | None = None,
    peak: Floats | None = None,
) -> Floats:
    """Return the log likelihood ratios (h,) of placements R (h, d, d) and t (h, d)."""
    share, found = np.empty((len(source), len(target))), np.empty(len(R))
    for h in range(len(R)):
        found[h] = soft_matches(
            source,
            variance,
            target,
            density,
            unexplained,
            furthest,
            R[h],
            t[h],
            share,
            metric,
            peak,
        )
    return found
