"""Rotations, and the best rotation for a cross moment, compiled; see `alignment`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.alignment import DEGENERATE
from relmap.core.linalg.compiling import helper
from relmap.core.linalg.small_kernels import diagonalise

STEPS = 15
"""Newton steps before falling back to an eigenvector."""
Matrix = tuple[float, float, float, float, float, float, float, float, float]
"""The entries of a matrix (3, 3), by row."""
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
    """Write the rotation (d, d) for an angle (1,) or a rotation vector (3,)."""
    if len(turn) == 1:
        R[0, 0] = R[1, 1] = np.cos(turn[0])
        R[1, 0] = np.sin(turn[0])
        R[0, 1] = -R[1, 0]
        return
    _enter(_rotation(turn[0], turn[1], turn[2]), R)


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
def _entries(A: Floats) -> Matrix:
    """Return the entries of a matrix (3, 3), by row: numbers take half the time of arrays."""
    a, b, c, d, e, f = A[0, 0], A[0, 1], A[0, 2], A[1, 0], A[1, 1], A[1, 2]
    return a, b, c, d, e, f, A[2, 0], A[2, 1], A[2, 2]


@helper
def _enter(entries: Matrix, A: Floats) -> None:
    """Write the entries of a matrix (3, 3)."""
    A[0, 0], A[0, 1], A[0, 2], A[1, 0], A[1, 1], A[1, 2] = entries[:6]
    A[2, 0], A[2, 1], A[2, 2] = entries[6:]


@helper
def _product(A: Matrix, B: Matrix) -> Matrix:
    """Return the product of two matrices."""
    a, b, c, d, e, f, g, h, i = A
    p, q, r, s, t, u, v, w, x = B
    above = a * p + b * s + c * v, a * q + b * t + c * w, a * r + b * u + c * x
    amid = d * p + e * s + f * v, d * q + e * t + f * w, d * r + e * u + f * x
    return *above, *amid, g * p + h * s + i * v, g * q + h * t + i * w, g * r + h * u + i * x


@helper
def _rotation(x: float, y: float, z: float) -> Matrix:
    """Return the rotation for a rotation vector (Rodrigues)."""
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    a = np.sin(angle) / angle if angle > 0 else 1.0
    b = (1 - np.cos(angle)) / square if angle > 1e-6 else 0.5
    xy, yz, zx = b * x * y, b * y * z, b * z * x
    above, amid = (1 - b * (y * y + z * z), xy - a * z), (xy + a * z, 1 - b * (z * z + x * x))
    return *above, zx + a * y, *amid, yz - a * x, zx - a * y, yz + a * x, 1 - b * (x * x + y * y)


@helper
def _newton_step(A: Matrix) -> tuple[float, float, float, bool]:
    """Return the rotation vector towards the largest trace of a rotated moment.

    And whether the trace has a maximum near.
    """
    a, b, c, d, e, f, g, h, i = A
    trace = a + e + i
    xx, yy, zz = -(a + a) / 2 + trace, -(e + e) / 2 + trace, -(i + i) / 2 + trace
    xy, xz, yz = -(b + d) / 2, -(c + g) / 2, -(f + h) / 2
    # The cofactors of the negative Hessian.
    p, q, r = yy * zz - yz * yz, zz * xx - xz * xz, xx * yy - xy * xy
    u, v, w = yz * xz - zz * xy, xy * yz - xz * yy, xz * xy - xx * yz
    det = xx * p + xy * u + xz * v
    if not (xx > 0 and r > 0 and det > 0):
        return 0.0, 0.0, 0.0, False
    k, m, n = f - h, g - c, b - d
    x = p / det * k + (u / det * m + v / det * n)
    y = u / det * k + (q / det * m + w / det * n)
    return x, y, v / det * k + (w / det * m + r / det * n), True


@helper
def best_rotation(moment: Floats, guess: Floats) -> Floats:
    """Return the rotation (d, d) that best fits a cross moment (3, 3).

    In space by Newton's method from a guess (d, d), several times faster than the eigenvector used
    if it does not converge. The maximised trace has a single maximum, so the result does not depend
    on the guess.
    """
    R = guess.copy()
    if len(guess) == 2:
        turn = np.empty(1)
        turn[0] = np.arctan2(moment[0, 1] - moment[1, 0], moment[0, 0] + moment[1, 1])
        turn_by(turn, R)
        return R
    M, now = _entries(moment), _entries(guess)
    for _ in range(STEPS):
        x, y, z, is_sound = _newton_step(_product(now, M))
        if not is_sound:
            break
        now = _product(_rotation(x, y, z), now)
        if max(abs(x), abs(y), abs(z)) < SETTLED:
            _enter(now, R)
            return R
    return _by_eigenvector(moment)
