"""Gauss-Newton on the joint sum of squares, with weights for what no noise explains."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid_each
from relmap.core.jointequations import Equations
from relmap.core.jointrows import JointRows
from relmap.core.tridiagonal import Factor, factor

logger = logging.getLogger(__name__)

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
SLOW = 0.1
"""A step that leaves a larger share of the one before asks for a new factor."""
HUBER = 5.0
"""Standard deviations beyond which a landmark in a segment counts less: it is no noise."""
CHI_MEDIAN = {2: 1.177, 3: 1.538}
"""Median length of a standard normal vector."""
EXACT = 1e-9
"""Residual, as a share of the map's size, that is taken for rounding."""
WORTH_SAYING = 0.1
"""Last step, as a share of the residuals, above which it is said that it did not settle."""
REWEIGHTED = 5
SAME = 0.05
"""Change of a weight that makes no difference."""
ALIKE = 0.01
"""Mean change of the weights that asks for no new factor."""


def settle(
    system: Equations, rows: JointRows, positions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], Factor]:
    """Return positions of the least weighted sum of squares, weights, and the matrix's factor.

    Parameters
    ----------
    system : Equations
    rows : JointRows
    positions : (m, d) float64, metres
        To start from.

    Returns
    -------
    positions : (m, d) float64, metres
    weight : (n,) float64
        Of an observation of each row.
    factor : Factor
    """
    weight = np.ones(len(rows.points))
    settled, solved = _settled(system, rows, positions, weight)
    for _ in range(REWEIGHTED):
        before, weight = weight, _weights(rows, settled, weight)
        change = np.abs(weight - before)
        if change.max() < SAME:
            break
        kept = solved if change.mean() < ALIKE else None
        settled, solved = _settled(system, rows, settled, weight, kept)
    return settled, weight, solved


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
    found: Factor | None = None,
) -> tuple[NDArray[np.float64], Factor]:
    """Return the positions of the least sum of squares, and the factor of the last matrix.

    Begins with the factor of a matrix that is nearly the same, where there is one.
    """
    size = np.abs(positions - positions.mean(axis=0)).max()
    rounding = len(rows.points) * (ROUNDING * size) ** 2
    before, least, damping, best, length, residual = np.inf, np.inf, 0.0, positions, np.inf, 0.0
    for _ in range(ROUNDS):
        placed = lay_on(rows, positions, weight)
        right, matrix = system.normal(positions, placed, weight, with_matrix=found is None)
        cost = system.cost.sum()
        if not cost <= WORSE * least + rounding:
            damping = max(DAMPED, MORE * damping)
            positions, found, before = best, None, np.inf
            continue
        best, least = positions, min(cost, least)
        if found is None:
            system.levels.damp(matrix, damping)
            found = factor(system.levels, matrix)
        step = found.solve(right)
        positions = system.moved(best, placed, weight, step)
        length = np.abs(positions - best).max()
        shrinks = length / before if np.isfinite(before) else None
        residual = np.sqrt(np.mean((placed - best[rows.landmark]) ** 2))
        near = length * (shrinks or 1.0) <= max(SETTLED * residual, ROUNDING * size)
        unsure = np.sum(right * step) <= UNSURE * cost / _freedoms(rows)
        if not damping and (near or unsure):
            return positions, found
        before = length
        if damping or (shrinks is not None and shrinks > SLOW):
            found, before = None, np.inf
        damping = damping / MORE if damping > DAMPED else 0.0
    if length > WORTH_SAYING * residual:
        logger.warning(
            "refinement did not settle in %d rounds: the last step was %.3g m", ROUNDS, length
        )
    placed = lay_on(rows, best, weight)
    return best, factor(system.levels, system.normal(best, placed, weight, True)[1])


def _freedoms(rows: JointRows) -> int:
    """Return how many more coordinates were observed than there are unknowns; at least 1."""
    d = rows.points.shape[1]
    unknown = d * len(rows.landmarks) + (3 * d - 3) * (len(rows.segments) - 1)
    return max(int(d * len(rows.points) - unknown), 1)


def _weights(
    rows: JointRows, positions: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return Huber's weights (n,) of the rows (Huber, 1964); all 1 where noise explains them.

    The scale is the median of the residuals, each in units of what the number of its observations
    makes it.
    """
    residual = norm(lay_on(rows, positions, weight) - positions[rows.landmark])
    residual *= np.sqrt(rows.n_seen)
    scale = np.median(residual) / CHI_MEDIAN[rows.points.shape[1]]
    size = np.abs(positions - positions.mean(axis=0)).max()
    limit = max(HUBER * scale, EXACT * size)
    return np.asarray(limit / np.maximum(residual, limit))


def norm(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths (n,) of vectors (n, d)."""
    return np.asarray(np.linalg.norm(vectors, axis=1))
