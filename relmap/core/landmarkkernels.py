"""Hot loops of the joint least squares with the placements eliminated; see `jointkernels`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.jointkernels import subtract
from relmap.core.kernels import compiled
from relmap.core.segmentkernels import derivative

LOOSE = 1e-9
"""What holds a placement that hangs by too little, as a share of what holds it otherwise."""


@compiled
def _patterns(visible: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the iterations (p,) of a segment that saw different things, and how many saw each."""
    bits, counts, n = np.empty(8, dtype=np.int64), np.zeros(8, dtype=np.int64), 0
    for bit in range(8):
        if not np.any((visible >> bit) & 1):
            continue
        known = n
        for pattern in range(n):
            if np.all((visible >> bit) & 1 == (visible >> bits[pattern]) & 1):
                known = pattern
        if known == n:
            bits[n] = bit
            n += 1
        counts[known] += 1
    return bits[:n], counts[:n]


@compiled
def _saw(visible: NDArray[np.uint8], bits: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which rows (n,) some iterations (p,) saw; (p, n)."""
    saw = np.empty((len(bits), len(visible)), dtype=np.bool_)
    for p in range(len(bits)):
        saw[p] = (visible >> bits[p]) & 1 == 1
    return saw


@compiled
def _pattern_of(bit: int, saw: NDArray[np.bool_], visible: NDArray[np.uint8]) -> int:
    """Return the row of `saw` that an iteration belongs to."""
    found = -1
    for p in range(len(saw)):
        if np.all(saw[p] == ((visible >> bit) & 1 == 1)):
            found = p
    return found


@compiled
def _inverse_root(G: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a small matrix's lower Cholesky factor (q, q); G is overwritten."""
    q = len(G)
    inverse = np.zeros((q, q))
    for a in range(q):
        for b in range(a + 1):
            for c in range(b):
                G[a, b] -= G[a, c] * G[b, c]
            if b < a:
                G[a, b] /= G[b, b]
        G[a, a] = np.sqrt(max(G[a, a], 1e-300))
        inverse[a, a] = 1 / G[a, a]
        for b in range(a):
            for c in range(b, a):
                inverse[a, b] -= G[a, c] * inverse[c, b] / G[a, a]
    return inverse


@compiled
def _roots(points: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return derivatives by a placement about the middle of points (n, d), as columns (q, n d)."""
    n, d = points.shape
    q = 3 if d == 2 else 6
    roots, J, middle = np.empty((q, n * d)), np.empty((d, q)), np.zeros(d)
    for row in range(n):
        middle += points[row] / n
    for row in range(n):
        derivative(points[row] - middle, J)
        for a in range(d):
            for b in range(q):
                roots[b, row * d + a] = np.sqrt(weight[row]) * J[a, b]
    return roots


@compiled
def _taken_away(
    roots: NDArray[np.float64], saw: NDArray[np.bool_], counts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return what free placements of patterns take away from points, as a root (p q, n d).

    `saw` (p, n) tells which points a pattern saw, `counts` (p,) how many iterations saw them.
    """
    q, columns = roots.shape
    d = columns // saw.shape[1]
    T = np.empty((len(saw) * q, columns))
    for p in range(len(saw)):
        seen = roots.copy()
        for row in range(saw.shape[1]):
            if not saw[p, row]:
                seen[:, row * d : (row + 1) * d] = 0.0
        G = np.dot(seen, seen.T)
        turn = np.max(np.diag(G)[: q - d])
        for a in range(q):
            G[a, a] += LOOSE * (turn if a < q - d else G[a, a])
        T[p * q : (p + 1) * q] = np.sqrt(counts[p]) * np.dot(_inverse_root(G), seen)
    return T


@compiled
def _release_but_one(
    T: NDArray[np.float64], saw: NDArray[np.bool_], counts: NDArray[np.int64], one: int
) -> None:
    """Let all placements but one of the pattern `one` be free."""
    q = len(T) // len(saw)
    T[one * q : (one + 1) * q] *= np.sqrt((counts[one] - 1) / counts[one])


@compiled
def landmark_equations(
    begin: NDArray[np.int64],
    landmark: NDArray[np.int64],
    visible: NDArray[np.uint8],
    points: NDArray[np.float64],
    residual: NDArray[np.float64],
    weight: NDArray[np.float64],
    anchor: tuple[int, int],
    gradient: NDArray[np.float64],
    buffer: NDArray[np.float64],
    level: NDArray[np.int64],
    place: NDArray[np.int64],
    width: NDArray[np.int64],
    offset: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Add the normal equations of the landmarks, with the placements eliminated.

    Each iteration has a placement of its own; those that saw the same share it.

    Parameters
    ----------
    points : (n, d) float64, map frame, metres
        Where the landmarks of the rows are.
    residual : (n, d) float64, map frame, metres
        How far from there the rows, as placed, are.
    weight : (n,) float64
        Of one observation.
    anchor : (segment, bit)
        The iteration whose placement is not free.
    gradient : (m, d) float64
        Added to.
    buffer : float64
        The matrix, added to; nothing is where it is empty.

    Returns
    -------
    (s,) float64
        Weighted sum of squares that is left of each segment.
    """
    d = points.shape[1]
    cost = np.zeros(len(begin) - 1)
    for s in range(len(begin) - 1):
        rows = slice(begin[s], begin[s + 1])
        bits, counts = _patterns(visible[rows])
        saw = _saw(visible[rows], bits)
        T = _taken_away(_roots(points[rows], weight[rows]), saw, counts)
        root = np.repeat(np.sqrt(weight[rows]), d)
        seen = np.repeat(np.dot(counts.astype(np.float64), saw.astype(np.float64)), d)
        e = root * np.ascontiguousarray(residual[rows]).reshape(-1)
        left = seen * e - np.dot(T.T, np.dot(T, e))
        cost[s] = np.dot(e, left)
        for i in range(len(left)):
            gradient[landmark[begin[s] + i // d], i % d] += root[i] * left[i]
        if len(buffer) > 0:
            if s == anchor[0]:
                one = _pattern_of(anchor[1], saw, visible[rows])
                _release_but_one(T, saw, counts, one)
            T *= root
            product = np.dot(T.T, T)
            for i in range(len(left)):
                product[i, i] -= root[i] ** 2 * seen[i]
            subtract(product, landmark[rows], d, buffer, level, place, width, offset)
    return cost
