"""The rotation that fits a cross moment best, compiled; see `relmap.core.alignment`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import DEGENERATE
from relmap.core.kernels import compiled

STEPS = 15
"""Newton steps after which a singular value decomposition decides."""
SETTLED = 1e-11
"""Last step, radians, after which the error is that of rounding: each squares the one before."""


@compiled
def inverse3(A: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """Return the inverse of a symmetric matrix (3, 3), and whether it is positive definite."""
    inverse = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inverse[i, j] = A[a, c] * A[b, d] - A[a, d] * A[b, c]
    det = A[0, 0] * inverse[0, 0] + A[0, 1] * inverse[1, 0] + A[0, 2] * inverse[2, 0]
    positive = A[0, 0] > 0 and inverse[2, 2] > 0 and det > 0
    return inverse / (det if det != 0 else np.nan), positive


@compiled
def fixes(scatter: NDArray[np.float64]) -> bool:
    """Tell whether the scatter (d, d) of centred points fixes a rotation."""
    d, trace, minors = len(scatter), np.trace(scatter), 0.0
    for a in range(d):
        for b in range(a):
            minors += scatter[a, a] * scatter[b, b] - scatter[a, b] * scatter[b, a]
    return trace > 0 and (d == 2 or minors > (DEGENERATE * trace) ** 2)


@compiled
def _decomposed(moment: NDArray[np.float64]) -> NDArray[np.float64]:
    U, _, Vt = np.linalg.svd(moment)
    R: NDArray[np.float64] = np.dot(U, Vt).T
    if np.linalg.det(R) < 0:  # Umeyama 1991: turn the axis of the smallest singular value
        Vt[-1] = -Vt[-1]
        R = np.dot(U, Vt).T
    return R


@compiled
def _turned(R: NDArray[np.float64], turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation (3, 3) turned on by a rotation vector (3,) (Rodrigues)."""
    angle = np.sqrt((turn**2).sum())
    a = np.sin(angle) / angle if angle > 0 else 1.0
    b = (1 - np.cos(angle)) / angle**2 if angle > 1e-6 else 0.5
    turned = np.empty((3, 3))
    for k in range(3):
        x, y, z = R[0, k], R[1, k], R[2, k]
        u, v, w = turn[1] * z - turn[2] * y, turn[2] * x - turn[0] * z, turn[0] * y - turn[1] * x
        turned[0, k] = x + a * u + b * (turn[1] * w - turn[2] * v)
        turned[1, k] = y + a * v + b * (turn[2] * u - turn[0] * w)
        turned[2, k] = z + a * w + b * (turn[0] * v - turn[1] * u)
    return turned


@compiled
def best_rotation(moment: NDArray[np.float64], guess: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (d, d) that fits a cross moment (d, d) best.

    In space by Newton's method from a guess, which is ten times faster than the singular value
    decomposition that decides where it does not settle.  The trace that is maximised has one
    maximum only, so it does not matter where the search begins.
    """
    if len(moment) == 2:
        c, s = moment[0, 0] + moment[1, 1], moment[0, 1] - moment[1, 0]
        length = np.hypot(c, s)
        c, s = (c / length, s / length) if length > 0 else (1.0, 0.0)
        return np.array([[c, -s], [s, c]])
    R, A, H, turn = guess, np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for _ in range(STEPS):
        for i in range(3):
            for j in range(3):
                A[i, j] = R[i, 0] * moment[0, j] + R[i, 1] * moment[1, j] + R[i, 2] * moment[2, j]
        trace = A[0, 0] + A[1, 1] + A[2, 2]
        for i in range(3):
            for j in range(3):
                H[i, j] = (trace if i == j else 0.0) - (A[i, j] + A[j, i]) / 2
        inverse, is_maximum = inverse3(H)
        if not is_maximum:
            break
        g = (A[1, 2] - A[2, 1], A[2, 0] - A[0, 2], A[0, 1] - A[1, 0])
        for i in range(3):
            turn[i] = inverse[i, 0] * g[0] + inverse[i, 1] * g[1] + inverse[i, 2] * g[2]
        R = _turned(R, turn)
        if np.abs(turn).max() < SETTLED:
            return R
    return _decomposed(moment)
