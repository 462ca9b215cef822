"""Rigid fits of matches whose noise differs by direction, compiled."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.geometry.fitting_kernels import fit_rows, keep_within, misfits, trimming_limit
from relmap.core.geometry.rotation_kernels import turn_by
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import factorise, identity, product, solve

HELD = 1e-9
"""Relative increase of the diagonal, for matches that leave a direction undetermined."""
TRIMMING_ROUNDS = 5
"""Maximum rounds of a fit."""
SETTLED = 0.1
"""Step, as a fraction of the tolerance, below which a fit has converged."""


@helper
def weighted_step(
    source: Floats, target: Floats, metric: Floats, rows: Bools, R: Floats, t: Floats
) -> float:
    """Improve a placement of some rows of matches (n, d) by a Gauss-Newton step, in place.

    Misfits count in the metric (n, d, d) of their targets.  Returns the length of the step.
    """
    n, d = source.shape
    q = 3 * d - 3
    J, off, turn, length = np.zeros((d, q)), np.empty(d), np.empty((d, d)), 0.0
    for a in range(d):
        J[a, q - d + a] = 1.0
    A, b = np.zeros((q, q)), np.zeros(q)
    for i in range(n):
        if rows[i]:
            _enter(J, off, R, t, source[i], target[i])
            _add(A, b, metric[i], J, off)
    for a in range(q):
        A[a, a] += HELD * A[a, a] + 1e-300
    factorise(A)
    solve(A, b)
    turn_by(b[: q - d], turn)
    turned = product(turn, R)
    for k in range(d * d):
        R[k // d, k % d] = turned[k // d, k % d]
    for a in range(d):
        off[a] = b[q - d + a]
        for c in range(d):
            off[a] += turn[a, c] * t[c]
    for a in range(d):
        length += (off[a] - t[a]) ** 2
        t[a] = off[a]
    return float(np.sqrt(length))


@compiled
def weighted_fit_rows(
    source: Floats, target: Floats, tolerance_m: float, metric: Floats
) -> tuple[Floats, Floats, int]:
    """Fit matches (n, d) in the metric (n, d, d) of each, leaving out inconsistent ones.

    As `trimmed_fit_rows` does; see `trimmed_fit`.
    """
    n, d = source.shape
    kept, misfit, listed = np.ones(n, dtype=np.bool_), np.empty(n), np.empty(n)
    R, t, _, _, _ = fit_rows(source, target, kept, identity(d))
    for _ in range(TRIMMING_ROUNDS):
        step_m = weighted_step(source, target, metric, kept, R, t)
        misfit = misfits(source, target, R, t, metric)
        limit = trimming_limit(misfit, kept, listed, tolerance_m)
        n_kept, same = keep_within(misfit, limit, kept)
        if n_kept < d:
            return R, t, -1
        if same and step_m < SETTLED * tolerance_m:
            break
    n_agreeing = 0
    for i in range(n):
        n_agreeing += misfit[i] <= tolerance_m
    return R, t, n_agreeing if n_agreeing >= d else -1


@helper
def _enter(J: Floats, off: Floats, R: Floats, t: Floats, source: Floats, target: Floats) -> None:
    """Write the derivative of a placed point by the rotation, and its distance to the target."""
    d = len(off)
    for a in range(d):
        off[a] = t[a]
        for c in range(d):
            off[a] += R[a, c] * source[c]
    if d == 2:
        J[0, 0], J[1, 0] = -off[1], off[0]
    else:
        J[0, 1], J[0, 2] = off[2], -off[1]
        J[1, 0], J[1, 2] = -off[2], off[0]
        J[2, 0], J[2, 1] = off[1], -off[0]
    for a in range(d):
        off[a] = target[a] - off[a]


@helper
def _add(A: Floats, b: Floats, metric: Floats, J: Floats, off: Floats) -> None:
    """Add one match to the normal equations."""
    weighed, (d, q) = product(metric, J), J.shape
    for a in range(d):
        left = 0.0
        for c in range(d):
            left += metric[a, c] * off[c]
        for i in range(q):
            b[i] += weighed[a, i] * left
            for j in range(i + 1):
                A[i, j] += weighed[a, i] * weighed[a, j]
