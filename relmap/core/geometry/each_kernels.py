"""Sums, fits and placements of many sets at once, compiled; see `alignment`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.rotation_kernels import best_rotation, fixes
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import identity


@compiled
def place_each(R: Floats, t: Floats, at: Ints, points: Floats) -> Floats:
    """Return points (k, d), each transformed by R and t of its placement `at` (k,)."""
    n, d = points.shape
    placed = np.empty((n, d))
    for i in range(n):
        k = at[i]
        for a in range(d):
            place = t[k, a]
            for b in range(d):
                place += R[k, a, b] * points[i, b]
            placed[i, a] = place
    return placed


@compiled
def misfits_each(R: Floats, t: Floats, at: Ints, source: Floats, target: Floats) -> Floats:
    """Return the distances (k,) of points (k, d), placed as by `place_each`, from targets."""
    placed, apart = place_each(R, t, at, source), np.empty(len(source))
    for i in range(len(source)):
        square = 0.0
        for a in range(source.shape[1]):
            square += (placed[i, a] - target[i, a]) ** 2
        apart[i] = np.sqrt(square)
    return apart


@compiled
def extent_of(points: Floats) -> float:
    """Return the longest side of the box around points (n, d), 0 if there are none."""
    longest = 0.0
    for a in range(points.shape[1]):
        low, high = np.inf, -np.inf
        for i in range(len(points)):
            low, high = min(low, points[i, a]), max(high, points[i, a])
        longest = max(longest, high - low)
    return longest


@compiled
def sums_each(values: Floats, at: Ints, n: int) -> Floats:
    """Return the sums (n, c) of values (k, c) by set `at` (k,), 0 to n - 1."""
    sums = np.zeros((n, values.shape[1]))
    for i in range(len(values)):
        for c in range(values.shape[1]):
            sums[at[i], c] += values[i, c]
    return sums


@helper
def _moments_each(
    source: Floats, target: Floats, weights: Floats, at: Ints, n: int
) -> tuple[Floats, Floats, Floats]:
    """Return the weighted means (2, n, d) of source and target of sets of matched points (k, d).

    And about them the mean cross moments and scatters of the source (n, 3, 3), padded with zeros in
    the plane.
    """
    k, d = source.shape
    total, means = np.zeros(n), np.zeros((2, n, d))
    moment, scatter = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
    for i in range(k):
        total[at[i]] += weights[i]
        for a in range(d):
            means[0, at[i], a] += weights[i] * source[i, a]
            means[1, at[i], a] += weights[i] * target[i, a]
    for m in range(n):
        total[m] = total[m] if total[m] > 0 else 1.0
        for a in range(d):
            means[0, m, a], means[1, m, a] = means[0, m, a] / total[m], means[1, m, a] / total[m]
    for i in range(k):
        m = at[i]
        for a in range(d):
            away = weights[i] / total[m] * (source[i, a] - means[0, m, a])
            for b in range(d):
                moment[m, a, b] += away * (target[i, b] - means[1, m, b])
                scatter[m, a, b] += away * (source[i, b] - means[0, m, b])
    return means, moment, scatter


@compiled
def fit_each(
    source: Floats, target: Floats, weights: Floats, at: Ints, n: int
) -> tuple[Floats, Floats, Bools]:
    """Fit sets `at` (k,), 0 to n - 1, of matched points (k, d); see `fit_rigid_each`."""
    d = source.shape[1]
    means, moment, scatter = _moments_each(source, target, weights, at, n)
    R, t, fixed = np.empty((n, d, d)), np.empty((n, d)), np.empty(n, dtype=np.bool_)
    for m in range(n):
        turn, fixed[m] = best_rotation(moment[m], identity(d)), fixes(scatter[m], d)
        for a in range(d):
            t[m, a] = means[1, m, a]
            for b in range(d):
                R[m, a, b] = turn[a, b]
                t[m, a] -= turn[a, b] * means[0, m, b]
    return R, t, fixed
