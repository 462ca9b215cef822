"""Rotations, and the best rotation for a cross moment, compiled; see `alignment`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.alignment import DEGENERATE
from relmap.core.linalg.compiling import helper
from relmap.core.linalg.small_kernels import diagonalise, enter_product, inverse3

STEPS = 15
"""Newton steps before falling back to an eigenvector."""
SETTLED = 1e-11
"""Last step, radians, after which the error is rounding: convergence is quadratic."""


@helper
def fixes(scatter: Floats, d: int) -> bool:
    """Return whether the scatter (3, 3) of centred points in d dimensions determines a rotation."""
    trace, minors = scatter[0, 0] + scatter[1, 1] + scatter[2, 2], 0.0
    for a in range(3):
        for b in range(a):
            minors += scatter[a, a] * scatter[b, b] - scatter[a, b] * scatter[b, a]
    return trace > 0 and (d == 2 or minors > (DEGENERATE * trace) ** 2)


@helper
def turn_by(turn: Floats, R: Floats) -> None:
    """Write the rotation (d, d) for an angle (1,) or a rotation vector (3,) (Rodrigues)."""
    if len(turn) == 1:
        R[0, 0] = R[1, 1] = np.cos(turn[0])
        R[1, 0] = np.sin(turn[0])
        R[0, 1] = -R[1, 0]
        return
    square = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]
    angle = np.sqrt(square)
    a = np.sin(angle) / angle if angle > 0 else 1.0
    b = (1 - np.cos(angle)) / square if angle > 1e-6 else 0.5
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        R[i, i] = 1 - b * (turn[j] * turn[j] + turn[k] * turn[k])
        R[i, j] = b * turn[i] * turn[j] - a * turn[k]
        R[j, i] = b * turn[i] * turn[j] + a * turn[k]


@helper
def _by_eigenvector(moment: Floats) -> Floats:
    """Return the best rotation (3, 3) from the eigenvector that is its quaternion (Horn, 1987)."""
    N = np.empty((4, 4))
    N[0, 0] = moment[0, 0] + moment[1, 1] + moment[2, 2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        N[0, i + 1] = N[i + 1, 0] = moment[j, k] - moment[k, j]
        N[j + 1, k + 1] = N[k + 1, j + 1] = moment[j, k] + moment[k, j]
        N[i + 1, i + 1] = moment[i, i] - moment[j, j] - moment[k, k]
    V, best = diagonalise(N), 0
    for a in range(1, 4):
        best = a if N[a, a] > N[best, best] else best
    R, w = np.empty((3, 3)), V[0, best]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        x, y, z = V[i + 1, best], V[j + 1, best], V[k + 1, best]
        R[i, i] = w * w + x * x - y * y - z * z
        R[i, j], R[j, i] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    return R


@helper
def best_rotation(moment: Floats, guess: Floats) -> Floats:
    """Return the rotation (d, d) that best fits a cross moment (3, 3).

    In space by Newton's method from a guess (d, d), several times faster than the eigenvector used
    if it does not converge. The maximised trace has a single maximum, so the result does not depend
    on the guess.
    """
    R, turn = guess.copy(), np.empty(2 * len(guess) - 3)
    if len(guess) == 2:
        turn[0] = np.arctan2(moment[0, 1] - moment[1, 0], moment[0, 0] + moment[1, 1])
        turn_by(turn, R)
        return R
    A, H, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for _ in range(STEPS):
        enter_product(R, moment, A)
        for i in range(3):
            for j in range(3):
                H[i, j] = -(A[i, j] + A[j, i]) / 2
            H[i, i] += A[0, 0] + A[1, 1] + A[2, 2]
        if not inverse3(H, inverse):
            break
        largest = 0.0
        for i in range(3):
            turn[i] = inverse[i, 0] * (A[1, 2] - A[2, 1])
            turn[i] += inverse[i, 1] * (A[2, 0] - A[0, 2]) + inverse[i, 2] * (A[0, 1] - A[1, 0])
            largest = max(largest, abs(turn[i]))
        turn_by(turn, H)
        enter_product(H, R, A)
        R, A = A, R
        if largest < SETTLED:
            return R
    return _by_eigenvector(moment)
