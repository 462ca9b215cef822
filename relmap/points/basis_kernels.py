"""The consistent basis, compiled; see `relmap.points.model`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.fitting_kernels import scatter_of
from relmap.core.geometry.rotation_kernels import fixes
from relmap.core.linalg.compiling import compiled, helper


@helper
def _scale(axis: Floats) -> None:
    """Normalise an axis (d,)."""
    square = 0.0
    for a in range(len(axis)):
        square += axis[a] * axis[a]
    for a in range(len(axis)):
        axis[a] /= np.sqrt(square)


@helper
def _axes(block: Floats, i: int, basis: Ints, axes: Floats) -> None:
    """Write the axes (d, d) of one iteration's basis."""
    d, first, last, along = len(axes), axes[0], axes[len(axes) - 1], 0.0
    for a in range(d):
        first[a] = block[basis[0], i, a] - block[basis[1], i, a]
    _scale(first)
    if d == 2:
        last[0], last[1] = -first[1], first[0]
        return
    for a in range(3):
        last[a] = block[basis[2], i, a] - block[basis[0], i, a]
        along += last[a] * first[a]
    for a in range(3):
        last[a] -= along * first[a]
    _scale(last)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        axes[1, a] = last[b] * first[c] - last[c] * first[b]


@helper
def _farthest(points: Floats, start: Floats, along: Floats) -> int:
    """Return the point (n, d) farthest from the line through a point in a direction (d,)."""
    farthest, row = -1.0, 0
    for k in range(len(points)):
        on, square = 0.0, 0.0
        for a in range(len(start)):
            on += (points[k, a] - start[a]) * along[a]
        for a in range(len(start)):
            square += (points[k, a] - start[a] - on * along[a]) ** 2
        if square > farthest:
            farthest, row = square, k
    return row


@helper
def choose_basis(points: Floats) -> Ints:
    """Return the rows (d,) of B0, B1 (and B2) of a group (g, d) in one iteration.

    None, (0,), if the points coincide or, in space, are collinear.
    """
    (g, d), basis = points.shape, np.empty(points.shape[1], dtype=np.int64)
    rows, along, centre = np.empty(g, dtype=np.bool_), np.zeros(d), np.zeros(d)
    for k in range(g):
        rows[k] = True
        for a in range(d):
            centre[a] += points[k, a]
    if g < d or not fixes(scatter_of(points, rows)[0], d):
        return basis[:0]
    for a in range(d):
        centre[a] /= g
    basis[0] = _farthest(points, centre, along)
    basis[1] = _farthest(points, points[basis[0]], along)
    if d == 3:
        for a in range(3):
            along[a] = points[basis[1], a] - points[basis[0], a]
        _scale(along)
        basis[2] = _farthest(points, points[basis[0]], along)
    return basis


@helper
def into_basis(block: Floats, basis: Ints) -> Floats:
    """Return each iteration of a group (g, i, d), robot frame, in the group frame of a basis."""
    g, m, d = block.shape
    placed, axes = np.empty((g, m, d)), np.empty((d, d))
    for i in range(m):
        _axes(block, i, basis, axes)
        for k in range(g):
            for a in range(d):
                place = 0.0
                for b in range(d):
                    place += axes[a, b] * (block[k, i, b] - block[basis[0], i, b])
                placed[k, i, a] = place
    return placed


@compiled
def average_in_basis(block: Floats) -> tuple[Floats, bool]:
    """Return the mean positions (g, d) of a group (g, i, d) in its basis, if it has one."""
    g, m, d = block.shape
    mean, now, finite = np.zeros((g, d)), np.empty((g, d)), True
    for k in range(g):
        for a in range(d):
            now[k, a] = block[k, m // 2, a]
    basis = choose_basis(now)
    if len(basis) == 0:
        return mean, False
    placed = into_basis(block, basis)
    for k in range(g):
        for i in range(m):
            for a in range(d):
                mean[k, a] += placed[k, i, a]
        for a in range(d):
            mean[k, a] /= m
            finite &= np.isfinite(mean[k, a])
    return mean, finite
