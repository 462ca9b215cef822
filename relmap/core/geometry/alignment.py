"""Least-squares rigid fit of matched points, in 2-D and 3-D.

The "Least Squared Fitting" of section III: Arun, Huang and Blostein, "Least-squares fitting of two
3-D point sets", PAMI 1987; the guard against reflections is Umeyama's, PAMI 1991.
"""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError

DEGENERATE = 1e-6
"""Smallest ratio of the spread of points across a line to that along it that determines a
rotation."""

HEAVIEST = 1e200
"""Larger weights, of hardly any noise, are as this one: their products overflow."""


def fit_rigid(source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return the rotation and translation that best align `source` to `target`.

    Minimises ``sum(|target - (source @ R.T + t)|^2)`` over proper rotations R, never a reflection.

    `source`, `target` (n, d), metres: matched points, at least one; d is 2 or 3. Returns `R` (d, d)
    and `t` (d,): ``target ~ source @ R.T + t``. Raises `RelmapError` if the shapes do not match, or
    a value is not finite.
    """
    is_matched = source.shape == target.shape and source.ndim == 2 and len(source) > 0
    if not is_matched or source.shape[1] not in (2, 3):
        raise RelmapError(
            f"rigid fit of {source.shape} to {target.shape}: both must be (n, 2) or both (n, 3)"
        )
    w = np.full(len(source), 1 / len(source))
    source_mean, target_mean = w @ source, w @ target
    moment = ((source - source_mean) * w[:, None]).T @ (target - target_mean)
    if not np.isfinite(moment).all():
        raise RelmapError("rigid fit: a coordinate is not finite")
    R = rotation_of_moment(moment)
    return R, target_mean - R @ source_mean


def rotation_of_moment(moment: Floats) -> Floats:
    """Return the proper rotations (..., d, d) that best fit cross moments (..., d, d).

    The moment is ``sum(w * source_i target_j)`` of centred points; reflections are excluded by
    flipping the axis of the smallest singular value (Umeyama 1991, eq. 43).
    """
    U, _, Vt = np.linalg.svd(moment)
    V = np.swapaxes(Vt, -1, -2)
    sign = np.sign(np.linalg.det(V @ np.swapaxes(U, -1, -2)))
    V[..., -1] *= sign[..., None]
    return np.asarray(V @ np.swapaxes(U, -1, -2))


def fit_rigid_each(
    source: Floats, target: Floats, weights: Floats, at: Ints, n: int
) -> tuple[Floats, Floats, Bools]:
    """Fit many sets of matched points at once, each as `fit_rigid` does.

    `source`, `target` (k, d), metres: matched points of all sets; `weights` (k,); `at` (k,): set of
    each pair, 0 to n - 1; `n`: number of sets. Returns `R` (n, d, d); `t` (n, d); `fixed` (n,):
    whether the points of a set determine its rotation; otherwise R and t are undefined.
    """
    import relmap.core.geometry.each_kernels as kernels

    source, target = np.ascontiguousarray(source), np.ascontiguousarray(target)
    return kernels.fit_each(
        source, target, np.minimum(weights, HEAVIEST), np.ascontiguousarray(at), n
    )


def place_each(R: Floats, t: Floats, at: Ints, points: Floats) -> Floats:
    """Return points (k, d), each transformed by R and t of its placement `at` (k,)."""
    import relmap.core.geometry.each_kernels as kernels

    R, t, points = (np.ascontiguousarray(each) for each in (R, t, points))
    return kernels.place_each(R, t, np.ascontiguousarray(at), points)


def extent_of(points: Floats) -> float:
    """Return the longest side of the box around points (n, d), 0 if there are none."""
    import relmap.core.geometry.each_kernels as kernels

    return kernels.extent_of(np.ascontiguousarray(points))


def sums_each(values: Floats, at: Ints, n: int) -> Floats:
    """Sum values (k, ...) by set `at` (k,), 0 to n - 1; (n, ...)."""
    import relmap.core.geometry.each_kernels as kernels

    columns = np.ascontiguousarray(values).reshape(len(values), math.prod(values.shape[1:]))
    sums = kernels.sums_each(columns, np.ascontiguousarray(at), n)
    return sums.reshape(n, *values.shape[1:])


def fixes_rotation(points: Floats) -> bool:
    """Return whether points (n, d) determine a rotation.

    In the plane two distinct points do; in space three points not on one line.
    """
    if len(points) < points.shape[1]:
        return False
    centred = points - points.mean(axis=0)
    scatter = centred.T @ centred
    trace = scatter.trace()
    # The sum of the principal minors approximates the product of the two largest eigenvalues.
    minors = (trace**2 - np.sum(scatter**2)) / 2
    return bool(trace > 0 and (len(scatter) == 2 or minors > (DEGENERATE * trace) ** 2))
