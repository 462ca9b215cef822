"""Normal equations with some unknowns eliminated, compiled; see `relmap.core.refinement.schur`.

`rows` are the residuals (r,), their Jacobians by the eliminated body (r, q) and by the kept
unknowns (r, k), weights (r,), and the indices (r, k) of the kept unknowns within the stretch.
`bodies` are `begin` (p + 1,) and `seen`, the rows of each body; the number of bodies with the same
observations that it represents, how many of them are free in the right-hand side and in the matrix,
(p,) each; and `along` (p, h, q), its unobservable directions. `stretches` are consecutive bodies:
`first` (g + 1,), the first body of each, `begin` (g + 1,) and `unknowns`, the kept unknowns of
each, ascending.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.cholesky_kernels import Layout, add_part, take_part
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import factorise, identity, solve

Rows = tuple[Floats, Floats, Floats, Floats, Ints]
Bodies = tuple[Ints, Ints, Floats, Floats, Floats, Floats]
Stretches = tuple[Ints, Ints, Ints]

STIFF = 1e3
"""Damping of a body along each unobservable direction, as a fraction of its other diagonal
entries."""


@helper
def _hold(matrix: Floats, along: Floats, share: float) -> None:
    """Damp a body (q, q), rotation and translation, along directions (h, q), slightly overall."""
    q = len(matrix)
    d, turn, shift = (q + 3) // 3, 0.0, 0.0
    for a in range(q):
        if a < q - d:
            turn = max(turn, matrix[a, a])
        else:
            shift += matrix[a, a]
    for a in range(q):
        for b in range(a + 1):
            for k in range(len(along)):
                matrix[a, b] += STIFF * shift * along[k, a] * along[k, b]
        matrix[a, a] += share * (turn if a < q - d else shift) + 1e-300


@helper
def _whitened(
    rows: Rows, bodies: Bodies, i: int, hold: float, root: Floats, coupling: Floats, pull: Floats
) -> None:
    """Write the Cholesky factor (q, q) of a body's matrix.

    Also write its coupling to the unknowns of its stretch (q, u) and its right-hand side (q,), both
    multiplied by the inverse of the factor.
    """
    off, by_eliminated, by_kept, weight, number = rows
    begin, seen, _, _, _, along = bodies
    for row in seen[begin[i] : begin[i + 1]]:
        for a in range(len(root)):
            weighted = weight[row] * by_eliminated[row, a]
            pull[a] -= weighted * off[row]
            for b in range(a + 1):
                root[a, b] += weighted * by_eliminated[row, b]
            for k in range(by_kept.shape[1]):
                coupling[a, number[row, k]] += weighted * by_kept[row, k]
    _hold(root, along[i], hold)
    factorise(root)
    for a in range(len(root)):
        for b in range(a):
            pull[a] -= root[a, b] * pull[b]
            for u in range(coupling.shape[1]):
                coupling[a, u] -= root[a, b] * coupling[b, u]
        pull[a] /= root[a, a]
        for u in range(coupling.shape[1]):
            coupling[a, u] /= root[a, a]


@helper
def _add_rows(rows: Rows, bodies: Bodies, i: int, right: Floats, part: Floats) -> float:
    """Add the contributions of a body's rows to the kept unknowns; return their cost."""
    off, _, by_kept, weight, number = rows
    begin, seen, times, _, _, _ = bodies
    squares = 0.0
    for row in seen[begin[i] : begin[i + 1]]:
        w = weight[row] * times[i]
        squares += w * off[row] ** 2
        for k in range(by_kept.shape[1]):
            right[number[row, k]] -= w * by_kept[row, k] * off[row]
            if len(part):
                for m in range(by_kept.shape[1]):
                    entry = w * by_kept[row, k] * by_kept[row, m]
                    part[number[row, k], number[row, m]] += entry
    return squares


@helper
def _eliminated(coupling: Floats, free: Floats) -> Floats:
    """Return what eliminated bodies add to the matrix (u, u), given how many of each are free (n,).

    `coupling` (n * q, u): multiplied by the inverse factor.
    """
    m, u = coupling.shape
    across, part = np.empty((u, m)), np.empty((u, u))
    for r in range(m):
        share = np.sqrt(free[r * len(free) // m])
        for k in range(u):
            across[k, r] = share * coupling[r, k]
    np.dot(across, across.T, part)
    for a in range(u):
        for b in range(u):
            part[a, b] = -part[a, b]
    return part


@compiled
def reduced_equations(
    rows: Rows,
    bodies: Bodies,
    stretches: Stretches,
    hold: float,
    layout: Layout,
    values: Floats,
    right: Floats,
) -> tuple[float, Floats]:
    """Add the reduced normal equations after eliminating the bodies.

    `hold`: damping of poorly determined bodies, as a fraction of the diagonal; `layout`: see
    `relmap.core.linalg.cholesky_kernels`; `values`: the matrix, updated in place unless it is
    empty; `right` (u,): updated in place. Returns `cost`: weighted sum of squares at the optimum of
    the bodies and `roots` (p, q, q): Cholesky factor of the matrix of each body.
    """
    first, begin, unknowns = stretches
    _, _, times, free, free_here, _ = bodies
    q = rows[1].shape[1]
    roots, cost = np.zeros((len(times), q, q)), 0.0
    place = np.empty(len(layout[1]), dtype=np.int64)
    for g in range(len(begin) - 1):
        own, n = unknowns[begin[g] : begin[g + 1]], first[g + 1] - first[g]
        coupling, pull = np.zeros((n * q, len(own))), np.zeros(n * q)
        for i in range(n):
            at, end, body = q * i, q * i + q, first[g] + i
            _whitened(rows, bodies, body, hold, roots[body], coupling[at:end], pull[at:end])
            squares = 0.0
            for a in range(at, end):
                squares += pull[a] * pull[a]
                pull[a] *= -free[body]
            cost -= free[body] * squares
        left = np.zeros(len(own))
        for r in range(n * q):
            for k in range(len(own)):
                left[k] += coupling[r, k] * pull[r]
        part = np.empty((0, 0))
        if len(values):
            part = _eliminated(coupling, free_here[first[g] : first[g + 1]])
        for i in range(first[g], first[g + 1]):
            cost += _add_rows(rows, bodies, i, left, part)
        for a in range(len(own)):
            right[own[a]] += left[a]
        if len(values):
            add_part(layout, own, part, values, place)
    return cost, roots


@compiled
def eliminated_steps(rows: Rows, bodies: Bodies, kept: Ints, step: Floats, roots: Floats) -> Floats:
    """Return the steps (p, q) of the bodies for a step (u,) of the kept unknowns.

    `kept` (r, k) are the kept unknowns of each row, `roots` as from `reduced_equations`.
    """
    off, by_eliminated, by_kept, weight, _ = rows
    begin, seen, _, free, _, _ = bodies
    steps = np.zeros((len(roots), by_eliminated.shape[1]))
    for i in range(len(steps)):
        for row in seen[begin[i] : begin[i + 1]]:
            left = off[row]
            for k in range(by_kept.shape[1]):
                left += by_kept[row, k] * step[kept[row, k]]
            for a in range(steps.shape[1]):
                steps[i, a] -= weight[row] * by_eliminated[row, a] * left
        solve(roots[i], steps[i])
        if free[i] <= 0:
            for a in range(steps.shape[1]):
                steps[i, a] = 0.0
    return steps


@compiled
def eliminated_covariances(
    rows: Rows, bodies: Bodies, stretches: Stretches, hold: float, layout: Layout, inverse: Floats
) -> Floats:
    """Return the covariances (p, q, q) of the bodies, from the inverse over the kept unknowns."""
    first, begin, unknowns = stretches
    q, place = rows[1].shape[1], np.empty(len(layout[1]), dtype=np.int64)
    found = np.empty((first[-1], q, q))
    for g in range(len(begin) - 1):
        own = unknowns[begin[g] : begin[g + 1]]
        kept = np.empty((len(own), len(own)))
        take_part(layout, own, inverse, kept, place)
        for i in range(first[g], first[g + 1]):
            root, coupling, pull = np.zeros((q, q)), np.zeros((q, len(own))), np.zeros(q)
            _whitened(rows, bodies, i, hold, root, coupling, pull)
            whitened = np.dot(np.dot(coupling, kept), coupling.T) + identity(q)
            for a in range(q):
                unit = np.zeros(q)
                unit[a] = 1.0
                solve(root, unit)
                for b in range(q):
                    found[i, a, b] = unit[b]
            half = np.dot(found[i], np.dot(root, whitened))
            covariance = np.dot(half, np.dot(root.T, found[i]))
            for a in range(q):
                for b in range(q):
                    found[i, a, b] = covariance[a, b]
    return found
