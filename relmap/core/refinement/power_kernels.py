"""Newton's equations of the least sum of powers, the placements of iterations eliminated, compiled.

Rows are observations, in the order of their iterations; `begin` (k + 1,) tells where each begins.
Observations count axis by axis in the robot's frame, where sensors have their noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled
from relmap.core.linalg.small_kernels import factorise, identity, solve
from relmap.core.refinement.joint_kernels import Blocks, subtract
from relmap.core.refinement.segment_kernels import derivative

HELD = 1e-12
"""What holds a placement that hangs by too little, as a share of what holds it most."""


@compiled
def _weighted(
    R: NDArray[np.float64], weight: NDArray[np.float64], J: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a derivative (d, q) times the weight (d, d), in the map's frame, of an observation."""
    d, q = J.shape
    result = np.zeros((d, q))
    for c in range(d):
        for b in range(q):
            turned = 0.0
            for a in range(d):
                turned += R[a, c] * J[a, b]
            for a in range(d):
                result[a, b] += R[a, c] * weight[c] * turned
    return result


@compiled
def _placement(
    first: int,
    end: int,
    turned: NDArray[np.float64],
    residual: NDArray[np.float64],
    weight: NDArray[np.float64],
    R: NDArray[np.float64],
    gradient: NDArray[np.float64],
    WJ: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Enter gradient (q,) and weighted derivatives (n, d, q); return the matrix's factor (q, q)."""
    d, q = WJ.shape[1:]
    A, J = np.zeros((q, q)), np.empty((d, q))
    gradient[:] = 0.0
    for row in range(first, end):
        derivative(turned, row, J)
        WJ[row - first] = _weighted(R, weight[row], J)
        for b in range(q):
            for a in range(d):
                gradient[b] += WJ[row - first, a, b] * residual[row, a]
                for c in range(q):
                    A[b, c] += WJ[row - first, a, b] * J[a, c]
    largest = 0.0
    for b in range(q):
        largest = max(largest, A[b, b])
    for b in range(q):
        A[b, b] += HELD * largest
    factorise(A)
    return A


@compiled
def _taken_away(L: NDArray[np.float64], WJ: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what a free placement takes from the matrix of n landmarks (n d, n d)."""
    n, d, q = WJ.shape
    roots, part = np.empty((n * d, q)), np.empty((n * d, n * d))
    for row in range(n * d):
        for c in range(q):
            root = WJ[row // d, row % d, c]
            for k in range(c):
                root -= L[c, k] * roots[row, k]
            roots[row, c] = root / L[c, c]
        for column in range(row + 1):
            entry = 0.0
            for c in range(q):
                entry += roots[row, c] * roots[column, c]
            part[row, column] = part[column, row] = entry
    return part


@compiled
def power_equations(
    begin: NDArray[np.int64],
    landmark: NDArray[np.int64],
    turned: NDArray[np.float64],
    residual: NDArray[np.float64],
    weight: NDArray[np.float64],
    R: NDArray[np.float64],
    right: NDArray[np.float64],
    buffer: NDArray[np.float64],
    blocks: Blocks,
) -> None:
    """Add the equations of the landmarks.

    Parameters
    ----------
    begin : (k + 1,) int64
    landmark : (n,) int64
    turned : (n, d) float64, metres
        The observations, turned into the map's frame.
    residual : (n, d) float64, map frame, metres
        How far they lie from their landmarks.
    weight : (n, d) float64
        Of each axis of the robot.
    R : (k, d, d) float64
    right : (m, d) float64
        Added to.
    buffer : float64
        The matrix, added to.
    """
    d = turned.shape[1]
    gradient, unit = np.empty(3 * d - 3), identity(d)
    for i in range(len(R)):
        first, end = begin[i], begin[i + 1]
        WJ = np.empty((end - first, d, len(gradient)))
        L = _placement(first, end, turned, residual, weight, R[i], gradient, WJ)
        part = _taken_away(L, WJ)
        solve(L, gradient)
        for j in range(end - first):
            W = _weighted(R[i], weight[first + j], unit)
            for a in range(d):
                for c in range(d):
                    part[j * d + a, j * d + c] -= W[a, c]
                    right[landmark[first + j], a] += W[a, c] * residual[first + j, c]
                for c in range(len(gradient)):
                    right[landmark[first + j], a] -= WJ[j, a, c] * gradient[c]
        subtract(part, landmark[first:end], d, buffer, blocks)


@compiled
def placement_steps(
    begin: NDArray[np.int64],
    turned: NDArray[np.float64],
    residual: NDArray[np.float64],
    weight: NDArray[np.float64],
    R: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the step (k, q) of each placement, turn and shift; parameters as above."""
    d = turned.shape[1]
    q = 3 * d - 3
    steps = np.empty((len(R), q))
    for i in range(len(R)):
        WJ = np.empty((begin[i + 1] - begin[i], d, q))
        L = _placement(begin[i], begin[i + 1], turned, residual, weight, R[i], steps[i], WJ)
        solve(L, steps[i])
    return -steps
