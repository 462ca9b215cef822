"""Rigid fits, compiled; see `relmap.core.alignment` and `relmap.core.completion`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled
from relmap.core.kernels.rotation import best_rotation, fixes


@compiled
def moments(
    source: NDArray[np.float64], target: NDArray[np.float64], rows: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the means (2, 3) of some rows of matched points (n, d), and their centred moments.

    These are that of source and target and the scatter of the source, (3, 3) each; what the plane
    lacks is 0.  In single numbers, because short loops over coordinates take several times as long.
    """
    n, space = len(source), source.shape[1] == 3
    x, y, z, u, v, w, count = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for i in range(n):
        if rows[i]:
            count += 1
            x, y, u, v = x + source[i, 0], y + source[i, 1], u + target[i, 0], v + target[i, 1]
            if space:
                z, w = z + source[i, 2], w + target[i, 2]
    means = np.array([[x, y, z], [u, v, w]]) / max(count, 1)
    (x, y, z), (u, v, w) = means
    xu, xv, xw, yu, yv, yw, zu, zv, zw = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        if rows[i]:
            a, b, c = source[i, 0] - x, source[i, 1] - y, 0.0
            p, q, r = target[i, 0] - u, target[i, 1] - v, 0.0
            xu, xv, yu, yv = xu + a * p, xv + a * q, yu + b * p, yv + b * q
            xx, xy, yy = xx + a * a, xy + a * b, yy + b * b
            if space:
                c, r = source[i, 2] - z, target[i, 2] - w
                xw, yw, zu, zv, zw = xw + a * r, yw + b * r, zu + c * p, zv + c * q, zw + c * r
                xz, yz, zz = xz + a * c, yz + b * c, zz + c * c
    moment = np.array([[xu, xv, xw], [yu, yv, yw], [zu, zv, zw]])
    return means, moment, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@compiled
def fit_rows(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    rows: NDArray[np.bool_],
    guess: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool, NDArray[np.float64]]:
    """Fit some rows of matched points (n, d) rigidly, as `fit_rigid` does with equal weights.

    Returns R, t, whether the rows fix R, and the scatter (d, d) of their source points.  A guess
    of R (d, d) saves time.
    """
    d = source.shape[1]
    means, moment, scatter = moments(source, target, rows)
    moment, scatter = moment[:d, :d].copy(), scatter[:d, :d].copy()
    R, t = best_rotation(moment, guess), means[1, :d].copy()
    for a in range(d):
        for b in range(d):
            t[a] -= R[a, b] * means[0, b]
    return R, t, fixes(scatter), scatter


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
        R, t, _, _ = fit_rows(source, target, kept, R)
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
