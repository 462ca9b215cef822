"""Small matrices, compiled: a few loops run and compile faster than LAPACK calls."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import helper

SWEEPS = 20
"""Maximum number of sweeps of Jacobi's method; five or six suffice."""
ROUNDING = 1e-17
"""Largest remaining off-diagonal entry, relative to the largest diagonal entry."""


@helper
def identity(n: int) -> Floats:
    """Return the unit matrix (n, n)."""
    unit = np.zeros((n, n))
    for i in range(n):
        unit[i, i] = 1.0
    return unit


@helper
def unset(n: int) -> Ints:
    """Return n entries of -1: compiles faster than numpy's `full`."""
    numbers = np.empty(n, dtype=np.int64)
    for i in range(n):
        numbers[i] = -1
    return numbers


@helper
def true_rows(rows: Bools) -> Ints:
    """Return which of rows (n,) are true: compiles faster than numpy's `flatnonzero`."""
    found, n = np.empty(len(rows), dtype=np.int64), 0
    for row in range(len(rows)):
        if rows[row]:
            found[n] = row
            n += 1
    return found[:n]


@helper
def picked(points: Floats, rows: Ints, every: int = 1) -> Floats:
    """Return one in `every` of some rows of points (n, d): compiles faster than indexing."""
    found = np.empty((-(-len(rows) // every), points.shape[1]))
    for k in range(len(found)):
        for a in range(points.shape[1]):
            found[k, a] = points[rows[k * every], a]
    return found


@helper
def square_of(A: Floats, x: Floats) -> float:
    """Return the squared length of the product of a matrix (n, m) and a vector (m,)."""
    square = 0.0
    for i in range(len(A)):
        entry = 0.0
        for j in range(len(x)):
            entry += A[i, j] * x[j]
        square += entry * entry
    return square


@helper
def square_between(x: Floats, y: Floats, metric: Floats | None, k: int, apart: Floats) -> float:
    """Return the squared distance of two points (d,), in metric k of (m, d, d) if there are any.

    Their difference is written to `apart` (d,).
    """
    square = 0.0
    for a in range(len(apart)):
        apart[a] = x[a] - y[a]
        square += apart[a] * apart[a]
    return square if metric is None else square_of(metric[k], apart)


@helper
def product(A: Floats, B: Floats) -> Floats:
    """Return the product (n, k) of two matrices (n, m) and (m, k)."""
    result = np.empty((len(A), B.shape[1]))
    enter_product(A, B, result)
    return result


@helper
def enter_product(A: Floats, B: Floats, result: Floats) -> None:
    """Write the product (n, k) of two matrices (n, m) and (m, k)."""
    for i in range(len(A)):
        for j in range(B.shape[1]):
            entry = 0.0
            for k in range(len(B)):
                entry += A[i, k] * B[k, j]
            result[i, j] = entry


@helper
def inverse3(A: Floats, inverse: Floats) -> bool:
    """Write the inverse of a symmetric matrix (3, 3); return whether it is positive definite."""
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inverse[i, j] = A[a, c] * A[b, d] - A[a, d] * A[b, c]
    det = A[0, 0] * inverse[0, 0] + A[0, 1] * inverse[1, 0] + A[0, 2] * inverse[2, 0]
    positive = A[0, 0] > 0 and inverse[2, 2] > 0 and det > 0
    for i in range(3):
        for j in range(3):
            inverse[i, j] /= det if det != 0 else np.nan
    return bool(positive)


@helper
def diagonalise(A: Floats) -> Floats:
    """Diagonalise a symmetric matrix (n, n) in place; return the eigenvectors.

    Jacobi's method (Golub and Van Loan, "Matrix Computations", 8.5).  The vectors are columns.
    """
    n = len(A)
    V = identity(n)
    for _ in range(SWEEPS):
        beside, largest = 0.0, 0.0
        for p in range(n):
            largest = max(largest, abs(A[p, p]))
            for q in range(p + 1, n):
                beside = max(beside, abs(A[p, q]))
        if beside <= ROUNDING * largest:
            break
        for p in range(n):
            for q in range(p + 1, n):
                angle = 0.5 * np.arctan2(2 * A[p, q], A[q, q] - A[p, p])
                c, s = np.cos(angle), np.sin(angle)
                for k in range(n):
                    A[k, p], A[k, q] = c * A[k, p] - s * A[k, q], s * A[k, p] + c * A[k, q]
                    V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]
                for k in range(n):
                    A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
    return V


@helper
def factorise(A: Floats) -> None:
    """Replace a positive definite matrix (n, n) by its lower Cholesky factor."""
    for i in range(len(A)):
        for j in range(i + 1):
            entry = A[i, j]
            for k in range(j):
                entry -= A[i, k] * A[j, k]
            A[i, j] = entry / A[j, j] if j < i else np.sqrt(max(entry, 1e-300))


@helper
def solve(L: Floats, x: Floats) -> None:
    """Replace the right-hand side (n,) by the solution, given the Cholesky factor (n, n)."""
    n = len(x)
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
