"""Rigid fits, compiled; see `alignment`, and `relmap.core.grouping.completion`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.rotation_kernels import best_rotation, fixes
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import smallest
from relmap.core.linalg.small_kernels import (
    identity,
    inverse3,
    picked,
    square_between,
    true_rows,
    unset,
)

TRIMMING_ROUNDS = 8


@helper
def centre_of(points: Floats, rows: Bools) -> tuple[float, float, float, int]:
    """Return the mean of some rows of points (n, d), with z = 0 in the plane, and their number."""
    x, y, z, count = 0.0, 0.0, 0.0, 0
    for i in range(len(points)):
        if rows[i]:
            count += 1
            x += points[i, 0]
            y += points[i, 1]
            if points.shape[1] == 3:
                z += points[i, 2]
    share = 1 / max(count, 1)
    return x * share, y * share, z * share, count


@helper
def _moments(source: Floats, target: Floats, rows: Bools, means: Floats) -> tuple[Floats, Floats]:
    """Return centred moments (3, 3) of some rows of matched points (n, d) about their means (2, 3).

    The moments are the cross moment of source and target and the scatter of the source, padded with
    zeros in the plane.
    """
    moment, scatter, space = np.empty((3, 3)), np.empty((3, 3)), source.shape[1] == 3
    xu, xv, xw, yu, yv, yw, zu, zv, zw = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    px, py, pz = means[0, 0], means[0, 1], means[0, 2]
    qx, qy, qz = means[1, 0], means[1, 1], means[1, 2]
    for i in range(len(source)):
        if rows[i]:
            x, y, u, v = source[i, 0] - px, source[i, 1] - py, target[i, 0] - qx, target[i, 1] - qy
            xu, xv, yu, yv = xu + x * u, xv + x * v, yu + y * u, yv + y * v
            xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
            if space:
                z, w = source[i, 2] - pz, target[i, 2] - qz
                xw, yw, zu, zv, zw = xw + x * w, yw + y * w, zu + z * u, zv + z * v, zw + z * w
                xz, yz, zz = xz + x * z, yz + y * z, zz + z * z
    moment[0, 0], moment[0, 1], moment[0, 2] = xu, xv, xw
    moment[1, 0], moment[1, 1], moment[1, 2] = yu, yv, yw
    moment[2, 0], moment[2, 1], moment[2, 2] = zu, zv, zw
    scatter[0, 0], scatter[1, 1], scatter[2, 2] = xx, yy, zz
    scatter[0, 1] = scatter[1, 0] = xy
    scatter[0, 2] = scatter[2, 0] = xz
    scatter[1, 2] = scatter[2, 1] = yz
    return moment, scatter


@helper
def fit_rows(
    source: Floats, target: Floats, rows: Bools, guess: Floats
) -> tuple[Floats, Floats, bool, Floats, Floats]:
    """Fit some rows of matched points (n, d) rigidly, as `fit_rigid` does with equal weights.

    Returns R, t, whether the rows determine R, and the scatter (3, 3) of their source points about
    the first of the means (2, 3), which follow.  An initial guess of R (d, d) saves time.
    """
    means = np.empty((2, 3))
    means[0, 0], means[0, 1], means[0, 2], _ = centre_of(source, rows)
    means[1, 0], means[1, 1], means[1, 2], _ = centre_of(target, rows)
    R, t, is_fixed, scatter = fit_about(means, source, target, rows, guess)
    return R, t, is_fixed, scatter, means


@helper
def fit_about(
    means: Floats, source: Floats, target: Floats, rows: Bools, guess: Floats
) -> tuple[Floats, Floats, bool, Floats]:
    """Fit rows as `fit_rows` does, given their means (2, 3); returns all but these."""
    moment, scatter = _moments(source, target, rows, means)
    d, R = source.shape[1], best_rotation(moment, guess)
    t = np.empty(d)
    for a in range(d):
        t[a] = means[1, a]
        for b in range(d):
            t[a] -= R[a, b] * means[0, b]
    return R, t, fixes(scatter, d), scatter


@helper
def scatter_of(points: Floats, rows: Bools) -> tuple[Floats, Floats, int]:
    """Return the scatter (3, 3) of some rows of points (n, d), their mean, twice, and number."""
    means = np.empty((2, 3))
    means[0, 0], means[0, 1], means[0, 2], count = centre_of(points, rows)
    for a in range(3):
        means[1, a] = means[0, a]
    return _moments(points, points, rows, means)[1], means, count


@compiled
def swings(points: Floats, rows: Bools) -> Floats:
    """Return the variance (n,) of points (n, d) placed by a fit to some rows of them.

    In units of the variance of one of these rows. It is large far from the line of the rows, where
    the rotation is poorly determined.
    """
    (scatter, means, count), swing = scatter_of(points, rows), np.empty(len(points))
    enter_swings(points, means, float(count), scatter, swing)
    return swing


@helper
def enter_swings(
    points: Floats, means: Floats, count: float, scatter: Floats, swing: Floats
) -> None:
    """Write the result of `swings` for points (n, d); the scatter (3, 3) is overwritten."""
    n, d = points.shape
    x, y, z = means[0, 0], means[0, 1], means[0, 2]
    trace = scatter[0, 0] + scatter[1, 1] + scatter[2, 2]
    for i in range(3):
        for j in range(3):
            scatter[i, j] = (trace if i == j else 0.0) - scatter[i, j]
    spread = np.empty((3, 3))
    inverse3(scatter, spread)
    xx, yy, zz = spread[0, 0], spread[1, 1], spread[2, 2]
    xy, xz, yz = 2 * spread[0, 1], 2 * spread[0, 2], 2 * spread[1, 2]
    for i in range(n):
        a, b = points[i, 0] - x, points[i, 1] - y
        if d == 2:  # a rotation moves a point in proportion to its distance from the axis
            turned = (a * a + b * b) / (2 * trace)
        else:
            c = points[i, 2] - z
            along = a * (xx * a + xy * b + xz * c) + b * (yy * b + yz * c) + zz * c * c
            turned = ((xx + yy + zz) * (a * a + b * b + c * c) - along) / 3
        swing[i] = 0.0 if np.isnan(a) else 1 / count + turned


@helper
def set_placement(R: Floats, t: Floats, i: int, turn: Floats, shift: Floats) -> None:
    """Store rotation and translation as the i-th of placements R (m, d, d) and t (m, d)."""
    for a in range(len(shift)):
        t[i, a] = shift[a]
        for b in range(len(shift)):
            R[i, a, b] = turn[a, b]


@helper
def placed_at(points: Floats, R: Floats, t: Floats) -> Floats:
    """Return points (n, d) transformed by R (d, d) and t (d,)."""
    n, d = points.shape
    placed = np.empty((n, d))
    for i in range(n):
        for a in range(d):
            place = 0.0
            for b in range(d):
                place += R[a, b] * points[i, b]
            placed[i, a] = place + t[a]
    return placed


@helper
def misfits(
    source: Floats, target: Floats, R: Floats, t: Floats, metric: Floats | None = None
) -> Floats:
    """Return the distance (n,) of each placed point from its target (n, d).

    With a metric (n, d, d) of the targets, in its units.
    """
    placed, found, apart = placed_at(source, R, t), np.empty(len(source)), np.empty(len(t))
    for i in range(len(source)):
        found[i] = np.sqrt(square_between(target[i], placed[i], metric, i, apart))
    return found


@helper
def keep_within(misfit: Floats, limit: float, kept: Bools) -> tuple[int, bool]:
    """Keep the rows (n,) with misfits up to a limit; return how many, and whether as before."""
    count, same = 0, True
    for i in range(len(misfit)):
        same &= kept[i] == (misfit[i] <= limit)
        kept[i] = misfit[i] <= limit
        count += kept[i]
    return count, same


@helper
def trimming_limit(misfit: Floats, kept: Bools, listed: Floats, tolerance_m: float) -> float:
    """Return the largest misfit (n,) of rows to keep: 1.5 medians of those kept so far.

    `listed` (n,): work space.
    """
    count = 0
    for i in range(len(misfit)):
        if kept[i]:
            listed[count], count = misfit[i], count + 1
    return max(tolerance_m, 1.5 * smallest(listed[:count], count // 2))


@compiled
def trimmed_fit_rows(
    source: Floats, target: Floats, tolerance_m: float
) -> tuple[Floats, Floats, int]:
    """Fit matches (n, d), leaving out inconsistent ones; see `trimmed_fit`.

    Returns R, t and the number of matches within the tolerance, -1 if too few are left.
    """
    n, d = source.shape
    kept, misfit, listed = np.zeros(n, dtype=np.bool_), np.zeros(n), np.empty(n)
    R, t, limit, n_agreeing = identity(d), np.zeros(d), np.inf, 0
    for _ in range(TRIMMING_ROUNDS):
        last = limit == tolerance_m
        n_kept, same = keep_within(misfit, limit, kept)
        if n_kept < d:
            return R, t, -1
        if last and same:
            break
        R, t, _, _, _ = fit_rows(source, target, kept, R)
        misfit = misfits(source, target, R, t)
        limit = trimming_limit(misfit, kept, listed, tolerance_m)
    for i in range(n):
        n_agreeing += misfit[i] <= tolerance_m
    return R, t, n_agreeing


@compiled
def trimmed_fit_each(
    source: Floats,
    target: Floats,
    near: Bools,
    tolerance_m: float,
    fewest: int,
    R: Floats,
    t: Floats,
) -> Ints:
    """Fit points (n, d) to each of several sets of targets (h, n, d); see `trimmed_fit`.

    `near` (h, n): the pairs of each; with fewer than `fewest`, the fit is left out. Sets R
    (h, d, d) and t (h, d), and returns the numbers of matches within the tolerance (h,), -1 without
    a fit.
    """
    n_agreeing = unset(len(target))
    for k in range(len(target)):
        rows = true_rows(near[k])
        if len(rows) >= fewest:
            turn, shift, n_agreeing[k] = trimmed_fit_rows(
                picked(source, rows), picked(target[k], rows), tolerance_m
            )
            set_placement(R, t, k, turn, shift)
    return n_agreeing
