"""Gauss-Newton on the joint sum of squares, with weights for what no noise explains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.geometry.alignment import fit_rigid_each
from relmap.core.geometry.robust import (
    EXACT,
    fit_robust_each,
    lenient,
    limit_of,
    robust_cost,
    strict,
)
from relmap.core.refinement.equations import Equations
from relmap.core.refinement.rows import JointRows

Weights = Callable[[NDArray[np.float64], float], NDArray[np.float64]]

ROUNDS = 30
SETTLED = 1e-3
"""Next step to be expected, as a share of what is left, at which the solution has settled."""
ROUNDING = 1e-13
"""The same, as a share of the map's size, where nothing is left."""
WORSE = 1.001
"""A step after which more than so many times the least sum of squares is left was too long."""
DAMPED, MORE = 1e-5, 10.0
"""What is added to the matrix's diagonal then, as a share of it, and how many times more each time
(Levenberg, 1944; Marquardt, 1963)."""
UNSURE = 1e-4
"""A step has settled too that gains no more, in squared standard deviations of the whole map."""
HOLD = 1e-9, 1e-6
"""What holds an unknown in a step, as a share of others and in observations: none moves far that
hangs by nothing."""
SLOW = 0.1
"""A step that leaves a larger share of the one before asks for a new factor."""
WORTH_SAYING = 0.1
"""Last step, as a share of the residuals, above which it is said that it did not settle."""
REWEIGHTED = 20
SAME = 0.05
"""Change of a weight that makes no difference."""
ALIKE = 0.01
"""Mean change of the weights that asks for no new factor."""


@dataclass(frozen=True, eq=False)
class Settled:
    """What the robust joint least squares came to.

    Attributes
    ----------
    positions : (m, d) float64, metres
    weight : (n,) float64
        Of an observation of each row.
    converged : bool
        Where not, the positions are the best that was found, which may be those to start from.
    """

    positions: NDArray[np.float64]
    weight: NDArray[np.float64]
    converged: bool


def settle(system: Equations, rows: JointRows, positions: NDArray[np.float64]) -> Settled:
    """Return positions of the least robust cost, no worse than those to start from.

    The first weights are those of the start: a few wrong matches would drag a map that is solved
    for without weights to where no weights bring it back from.  Lenient weights spread a drift over
    a loop; then what still fits nowhere is let go.

    Parameters
    ----------
    system : Equations
    rows : JointRows
    positions : (m, d) float64, metres
        To start from.
    """
    start = positions
    residual = _residuals_at(rows, start)
    limit = limit_of(residual, start.shape[1], _size(start))
    weight = lenient(residual, limit)
    positions, found, converged = _settled(system, rows, start, weight)
    for function in (lenient, strict):
        for _ in range(REWEIGHTED):
            before = weight
            weight, limit = _weights(rows, positions, weight, function, limit)
            change = np.abs(weight - before)
            if change.max() < SAME:
                break
            kept = found if change.mean() < ALIKE else None
            positions, found, converged = _settled(system, rows, positions, weight, kept)
    rounding = len(rows.points) * (EXACT * _size(start)) ** 2
    cost = robust_cost(_residuals_at(rows, positions), limit)
    if not cost <= WORSE * robust_cost(residual, limit) + rounding:
        return Settled(start, strict(residual, limit), converged=False)
    return Settled(positions, weight, converged)


def _residuals_at(rows: JointRows, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what is left of the rows (n,), each segment laid on as most of its rows say."""
    there, n_seen, at = positions[rows.landmark], rows.n_seen.astype(np.float64), rows.segment
    R, t, _, _ = fit_robust_each(rows.points, there, n_seen, at, len(rows.segments))
    placed = np.einsum("nij,nj->ni", R[at], rows.points) + t[at]
    return norm(placed - there) * np.sqrt(n_seen)


def lay_on(
    rows: JointRows, positions: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the rows (n, d), each segment laid on the positions as it fits best."""
    there = positions[rows.landmark]
    R, t, _ = fit_rigid_each(
        rows.points, there, weight * rows.n_seen, rows.segment, len(rows.segments)
    )
    return np.asarray(np.einsum("nij,nj->ni", R[rows.segment], rows.points) + t[rows.segment])


def _settled(
    system: Equations,
    rows: JointRows,
    positions: NDArray[np.float64],
    weight: NDArray[np.float64],
    found: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, bool]:
    """Return the positions of the least sum of squares, the last factor, and if it converged.

    Begins with the factor of a matrix that is nearly the same, where there is one.
    """
    size = _size(positions)
    rounding = len(rows.points) * (ROUNDING * size) ** 2
    before, least, damping, best, length, residual = np.inf, np.inf, 0.0, positions, np.inf, 0.0
    for _ in range(ROUNDS):
        placed = lay_on(rows, positions, weight)
        right, matrix = system.normal(positions, placed, weight, HOLD if found is None else None)
        cost = system.cost.sum()
        if not cost <= WORSE * least + rounding:
            damping = max(DAMPED, MORE * damping)
            positions, found, before = best, None, np.inf
            continue
        best, least = positions, min(cost, least)
        if found is None:
            system.pattern.hold(matrix, damping, 0.0)
            system.pattern.factorise(matrix)
            found = matrix
        step = system.pattern.solve(found, right)
        positions = system.moved(best, placed, weight, step)
        length = np.abs(positions - best).max()
        shrinks = length / before if np.isfinite(before) else None
        residual = np.sqrt(np.mean((placed - best[rows.landmark]) ** 2))
        near = length * (shrinks or 1.0) <= max(SETTLED * residual, ROUNDING * size)
        unsure = np.sum(right * step) <= UNSURE * cost / _freedoms(rows)
        if not damping and (near or unsure):
            return positions, found, True
        before = length
        if damping or (shrinks is not None and shrinks > SLOW):
            found, before = None, np.inf
        damping = damping / MORE if damping > DAMPED else 0.0
    return best, found, length <= WORTH_SAYING * residual


def _freedoms(rows: JointRows) -> int:
    """Return how many more coordinates were observed than there are unknowns; at least 1."""
    d = rows.points.shape[1]
    unknown = d * len(rows.landmarks) + (3 * d - 3) * (len(rows.segments) - 1)
    return max(int(d * len(rows.points) - unknown), 1)


def _weights(
    rows: JointRows,
    positions: NDArray[np.float64],
    weight: NDArray[np.float64],
    function: Weights,
    at_most: float,
) -> tuple[NDArray[np.float64], float]:
    """Return the weights (n,) of the rows, all 1 where noise explains them, and their limit.

    The limit never grows: many wrong matches that count a little raise the noise, and so each
    other's weights.
    """
    residual = norm(lay_on(rows, positions, weight) - positions[rows.landmark])
    residual *= np.sqrt(rows.n_seen)
    limit = min(limit_of(residual, positions.shape[1], _size(positions)), at_most)
    return function(residual, limit), limit


def _size(positions: NDArray[np.float64]) -> float:
    return float(np.abs(positions - positions.mean(axis=0)).max())


def norm(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths (n,) of vectors (n, d)."""
    return np.asarray(np.linalg.norm(vectors, axis=1))
