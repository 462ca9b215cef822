"""The consistent basis, compiled; see `relmap.points.basis`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
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


@compiled
def into_basis(block: Floats, basis: Ints) -> Floats:
    """Transform each iteration of a block (g, i, d) into the basis of rows; see `to_basis`."""
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
