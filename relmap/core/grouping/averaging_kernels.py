"""Averaging a chart, compiled; see `completion` and `noise`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.geometry.fitting_kernels import add_swings, fit_rows, set_placement
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import median, smallest
from relmap.core.linalg.small_kernels import identity


@helper
def place(points: Floats, R: Floats, t: Floats, i: int, placed: Floats) -> None:
    """Transform the points (n, d) of iteration i, and enter them in places (n, i, d)."""
    n, d = points.shape
    for k in range(n):
        for a in range(d):
            at = t[i, a]
            for b in range(d):
                at += R[i, a, b] * points[k, b]
            placed[k, i, a] = at


@helper
def _averages(placed: Floats, amplified: Floats) -> tuple[Floats, Floats]:
    """Return the mean places (n, d), and the sums of squared deviations (n,) from them.

    The places are (n, i, d), with NaN where unseen; amplified variances (n,) are passed as sums and
    averaged too. The largest deviation of each row is left out: one bad observation is not a
    motion.
    """
    n, m, d = placed.shape
    mean, squares = np.zeros((n, d)), np.zeros(n)
    for k in range(n):
        count, largest = 0, 0.0
        for i in range(m):
            if not np.isnan(placed[k, i, 0]):
                count += 1
                for a in range(d):
                    mean[k, a] += placed[k, i, a]
        amplified[k] /= count
        for a in range(d):
            mean[k, a] /= count
        for i in range(m):
            square = 0.0
            for a in range(d):
                apart = placed[k, i, a] - mean[k, a]
                square += apart * apart
            if not np.isnan(square):
                squares[k] += square
                largest = max(largest, square)
        squares[k] -= largest
    return mean, squares


@compiled
def place_iterations(
    block: Floats, reference: Floats
) -> tuple[Floats, Floats, Bools, Floats, Floats, Floats]:
    """Fit every iteration of a block (n, i, d) to a reference (n, d) and average; see `complete`.

    Returns R (i, d, d), t (i, d) and which iterations are fixed (i,); then for each landmark (n,),
    defined if it was ever placed, the mean place (n, d), the sum of squared deviations except the
    largest, and its variance relative to the noise.
    """
    n, m, d = block.shape
    R, t, fixed = np.empty((m, d, d)), np.empty((m, d)), np.zeros(m, dtype=np.bool_)
    here, rows, guess = np.empty((n, d)), np.zeros(n, dtype=np.bool_), identity(d)
    placed, amplified = np.empty((n, m, d)), np.zeros(n)
    placed[:] = np.nan
    for i in range(m):
        for k in range(n):
            rows[k] = not np.isnan(block[k, i, 0] + reference[k, 0])
            for a in range(d):
                here[k, a] = block[k, i, a]
        turn, shift, fixed[i], scatter = fit_rows(here, reference, rows, guess)
        set_placement(R, t, i, turn, shift)
        if fixed[i]:
            guess = turn
            add_swings(here, rows, scatter, amplified)
            for k in range(n):
                amplified[k] += 0.0 if np.isnan(here[k, 0]) else 1.0
            place(here, R, t, i, placed)
    mean, squares = _averages(placed, amplified)
    return R, t, fixed, mean, squares, amplified


@helper
def _radial_variances(block: Floats, inner: Bools, variance: Floats) -> None:
    """Enter the variance (g,) of the distances of a group's members from its inner centre."""
    g, m, d = block.shape
    centre, radius, h = np.zeros((m, d)), np.empty(m), 0
    for k in range(g):
        h += inner[k]
    for k in range(g):
        for i in range(m):
            for a in range(d):
                centre[i, a] += block[k, i, a] / h if inner[k] else 0.0
    for k in range(g):
        mean, squares = 0.0, 0.0
        for i in range(m):
            square = 0.0
            for a in range(d):
                square += (block[k, i, a] - centre[i, a]) ** 2
            radius[i] = np.sqrt(square)
            mean += radius[i] / m
        for i in range(m):
            squares += (radius[i] - mean) ** 2
        # The centre contains 1/h of the noise of each of its own members, correlated with theirs.
        variance[k] = squares / (m - 1) * (h / (h - 1) if inner[k] else h / (h + 1))


@compiled
def steady_variance(block: Floats, freedoms_median: float) -> float:
    """Return the typical variance of the distances of a group (g, i, d) from its centre.

    The centre is that of the steadier half, as a moving member would shift it.
    """
    g = len(block)
    inner, variance, listed, limit = np.zeros(g, dtype=np.bool_), np.zeros(g), np.empty(g), np.inf
    for _ in range(3):
        for k in range(g):
            inner[k] = variance[k] <= limit
        _radial_variances(block, inner, variance)
        for k in range(g):
            listed[k] = variance[k]
        limit = smallest(listed, min(max(3, (g + 1) // 2), g) - 1)
    return median(listed) / freedoms_median
