"""Rigid fits, compiled; see `relmap.core.alignment` and `relmap.core.completion`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import DEGENERATE
from relmap.core.kernels import compiled


@compiled
def fit_rows(
    source: NDArray[np.float64], target: NDArray[np.float64], rows: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool, NDArray[np.float64]]:
    """Fit some rows of matched points (n, d) rigidly, as `fit_rigid` does with equal weights.

    Returns R, t, whether the rows fix R, and the scatter (d, d) of their source points.
    """
    n, d = source.shape
    source_mean, target_mean, count = np.zeros(d), np.zeros(d), 0
    for i in range(n):
        if rows[i]:
            count += 1
            for a in range(d):
                source_mean[a] += source[i, a]
                target_mean[a] += target[i, a]
    source_mean /= max(count, 1)
    target_mean /= max(count, 1)
    moment, scatter = np.zeros((d, d)), np.zeros((d, d))
    for i in range(n):
        if rows[i]:
            for a in range(d):
                here = source[i, a] - source_mean[a]
                for b in range(d):
                    moment[a, b] += here * (target[i, b] - target_mean[b])
                    scatter[a, b] += here * (source[i, b] - source_mean[b])
    spread = np.linalg.eigvalsh(scatter)
    widest = spread[d - 1]
    fixed = widest > 0 and spread[1] > DEGENERATE**2 * widest
    U, _, Vt = np.linalg.svd(moment)
    R = np.dot(U, Vt).T
    if np.linalg.det(R) < 0:  # Umeyama 1991: turn the axis of the smallest singular value
        for a in range(d):
            Vt[d - 1, a] = -Vt[d - 1, a]
        R = np.dot(U, Vt).T
    return R, target_mean - np.dot(R, source_mean), fixed, scatter


@compiled
def trimmed_fit_rows(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    tolerance_m: float,
    rounds: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Fit matches (n, d), leaving out those that disagree; see `trimmed_fit`.

    Returns R, t and the number of matches within the tolerance, which is -1 where too few are left.
    """
    n, d = source.shape
    kept, near, error = np.ones(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_), np.zeros(n)
    R, t = np.eye(d), np.zeros(d)
    for _ in range(rounds):
        if kept.sum() < d:
            return R, t, -1
        R, t, _, _ = fit_rows(source, target, kept)
        for i in range(n):
            square = 0.0
            for a in range(d):
                placed = t[a] - target[i, a]
                for b in range(d):
                    placed += R[a, b] * source[i, b]
                square += placed * placed
            error[i] = np.sqrt(square)
        middle = np.sort(error[kept])[kept.sum() // 2]
        limit = max(tolerance_m, 1.5 * middle)
        near = error <= limit
        if limit == tolerance_m and (near == kept).all():
            break
        kept = near
    return R, t, (error <= tolerance_m).sum()


@compiled
def claims(wanted: NDArray[np.int64], distance: NDArray[np.float64], n: int) -> NDArray[np.bool_]:
    """Of rows that want the same target, tell the nearest; see `nearest_claim`."""
    winner = np.full(n + 1, -1)
    for row in range(len(wanted)):
        if np.isfinite(distance[row]):
            best = winner[wanted[row]]
            if best < 0 or distance[row] < distance[best]:
                winner[wanted[row]] = row
    won = np.zeros(len(wanted), dtype=np.bool_)
    for target in range(n):
        if winner[target] >= 0:
            won[winner[target]] = True
    return won


@compiled
def _mean_places(placed: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean (n, d) of places (n, i, d) and their squared deviations (n,), without NaN.

    The largest deviation is left out: one bad observation is not a motion.
    """
    n, m, d = placed.shape
    mean, squares = np.full((n, d), np.nan), np.full(n, np.nan)
    for k in range(n):
        count = 0
        mean[k] = 0.0
        for i in range(m):
            if not np.isnan(placed[k, i, 0]):
                count += 1
                for a in range(d):
                    mean[k, a] += placed[k, i, a]
        mean[k] /= count if count else np.nan
        if count:
            squares[k], largest = 0.0, 0.0
            for i in range(m):
                if not np.isnan(placed[k, i, 0]):
                    square = 0.0
                    for a in range(d):
                        square += (placed[k, i, a] - mean[k, a]) ** 2
                    squares[k] += square
                    largest = max(largest, square)
            squares[k] -= largest
    return mean, squares


@compiled
def _amplification(
    points: NDArray[np.float64],
    rows: NDArray[np.bool_],
    scatter: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the variance (n,) of points placed by a fit to some rows, in units of the noise's."""
    n, d = points.shape
    centre, count = np.zeros(d), rows.sum()
    for i in range(n):
        if rows[i]:
            for a in range(d):
                centre[a] += points[i, a] / count
    trace = np.trace(scatter)
    spread = np.eye(d) / trace  # in the plane, a turn moves a point at its distance, any way round
    share = 1 / d
    if d == 3:
        spread = np.linalg.inv(trace * np.eye(3) - scatter)
    amplified = np.zeros(n)
    for i in range(n):
        square, along = 0.0, 0.0
        for a in range(d):
            reach = points[i, a] - centre[a]
            square += reach * reach
            for b in range(d):
                along += reach * spread[a, b] * (points[i, b] - centre[b])
        turning = along if d == 2 else np.trace(spread) * square - along
        amplified[i] = 1 + 1 / count + share * turning
    return amplified


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
    R, t = np.zeros((m, d, d)), np.zeros((m, d))
    fixed = np.zeros(m, dtype=np.bool_)
    placed = np.full((n, m, d), np.nan)
    amplified, counts = np.zeros(n), np.zeros(n)
    for i in range(m):
        here = np.ascontiguousarray(block[:, i, :])
        seen = ~np.isnan(here[:, 0])
        rows = seen & ~np.isnan(reference[:, 0])
        R[i], t[i], fixed[i], scatter = fit_rows(here, reference, rows)
        if fixed[i]:
            amplification = _amplification(here, rows, scatter)
            for k in range(n):
                if seen[k]:
                    for a in range(d):
                        placed[k, i, a] = t[i, a]
                        for b in range(d):
                            placed[k, i, a] += R[i, a, b] * here[k, b]
                    amplified[k] += amplification[k]
                    counts[k] += 1
    mean, squares = _mean_places(placed)
    return R, t, fixed, mean, squares, np.where(counts > 0, amplified / counts, np.nan)
