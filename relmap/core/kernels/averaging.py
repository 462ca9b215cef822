"""Averaging what a chart shows, compiled; see `relmap.core.completion` and `relmap.core.noise`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled
from relmap.core.kernels.fitting import fit_rows
from relmap.core.kernels.rotation import inverse3


@compiled
def _amplification(
    points: NDArray[np.float64], rows: NDArray[np.bool_], scatter: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the variance (n,) of points placed by a fit to some rows, in units of the noise's."""
    n, d = points.shape
    centre, count = np.zeros(3), rows.sum()
    for i in range(n):
        if rows[i]:
            for a in range(d):
                centre[a] += points[i, a] / count
    x, y, z = centre
    trace = np.trace(scatter)
    amplified = np.empty(n)
    if d == 2:  # a turn moves a point at its distance, any way round
        for i in range(n):
            square = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
            amplified[i] = 1 + 1 / count + square / (2 * trace)
        return amplified
    spread, _ = inverse3(trace * np.eye(3) - scatter)
    sum_, xx, yy, zz = np.trace(spread), spread[0, 0], spread[1, 1], spread[2, 2]
    xy, xz, yz = 2 * spread[0, 1], 2 * spread[0, 2], 2 * spread[1, 2]
    for i in range(n):
        a, b, c = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
        along = a * (xx * a + xy * b + xz * c) + b * (yy * b + yz * c) + zz * c * c
        amplified[i] = 1 + 1 / count + (sum_ * (a * a + b * b + c * c) - along) / 3
    return amplified


@compiled
def _deviations(
    placed: NDArray[np.float64], row: NDArray[np.int64], mean: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the sum of squared deviations (n,) of places (k, d) from the means (n, d) of rows.

    The largest of each row is left out: one bad observation is not a motion.
    """
    n, d = mean.shape
    squares, largest = np.zeros(n), np.zeros(n)
    for j in range(len(row)):
        square = 0.0
        for a in range(d):
            square += (placed[j, a] - mean[row[j], a]) ** 2
        squares[row[j]] += square
        largest[row[j]] = max(largest[row[j]], square)
    return squares - largest


@compiled
def place_iterations(
    block: NDArray[np.float64], reference: NDArray[np.float64]
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.bool_],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]:
    """Fit every iteration of a block (n, i, d) to a reference (n, d) and average; see `complete`.

    Returns R (i, d, d), t (i, d) and which iterations are fixed (i,); then for each landmark (n,),
    NaN where it was never placed, the mean place (n, d), the sum of squared deviations from it but
    for the largest, and what its variance is in units of the noise's.
    """
    n, m, d = block.shape
    R, t, fixed = np.zeros((m, d, d)), np.zeros((m, d)), np.zeros(m, dtype=np.bool_)
    placed, row, n_placed = np.empty((n * m, d)), np.empty(n * m, dtype=np.int64), 0
    mean, counts, amplified = np.zeros((n, d)), np.zeros(n), np.zeros(n)
    guess = np.eye(d)
    for i in range(m):
        seen = np.flatnonzero(~np.isnan(block[:, i, 0]))
        here, there = np.empty((len(seen), d)), np.empty((len(seen), d))
        for j in range(len(seen)):
            for a in range(d):
                here[j, a] = block[seen[j], i, a]
                there[j, a] = reference[seen[j], a]
        rows = ~np.isnan(there[:, 0])
        R[i], t[i], fixed[i], scatter = fit_rows(here, there, rows, guess)
        if fixed[i]:
            guess = R[i].copy()
            amplification = _amplification(here, rows, scatter)
            for j in range(len(seen)):
                x, y = here[j, 0], here[j, 1]
                z = here[j, 2] if d == 3 else 0.0
                for a in range(d):
                    place = t[i, a] + R[i, a, 0] * x + R[i, a, 1] * y
                    place += R[i, a, 2] * z if d == 3 else 0.0
                    placed[n_placed, a] = place
                    mean[seen[j], a] += place
                row[n_placed] = seen[j]
                amplified[seen[j]] += amplification[j]
                counts[seen[j]] += 1
                n_placed += 1
    counts = np.where(counts > 0, counts, np.nan)
    for k in range(n):
        mean[k] /= counts[k]
    squares = _deviations(placed[:n_placed], row[:n_placed], mean)
    return R, t, fixed, mean, np.where(counts > 0, squares, np.nan), amplified / counts


@compiled
def steady_variance(block: NDArray[np.float64], freedoms_median: float) -> float:
    """Return the typical variance of the distances from the centre of a group (g, i, d).

    The centre is that of the steadier half: one that moves would take it along.
    """
    g, m, d = block.shape
    inner, variance = np.ones(g, dtype=np.bool_), np.empty(g)
    radius, centre = np.empty(m), np.empty((m, d))
    for _ in range(3):
        h = inner.sum()
        centre[:] = 0.0
        for k in range(g):
            if inner[k]:
                centre += block[k] / h
        for k in range(g):
            for i in range(m):
                square = 0.0
                for a in range(d):
                    square += (block[k, i, a] - centre[i, a]) ** 2
                radius[i] = np.sqrt(square)
            # The centre holds 1/h of the noise of each of its own, with or against the member's.
            scale = h / (h - 1) if inner[k] else h / (h + 1)
            variance[k] = ((radius - radius.mean()) ** 2).sum() / (m - 1) * scale
        inner[:] = False
        inner[np.argsort(variance, kind="mergesort")[: max(3, (g + 1) // 2)]] = True
    return np.median(variance) / freedoms_median
