"""The consistent basis, compiled; see `relmap.points.basis`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled


@compiled
def into_basis(block: NDArray[np.float64], basis: NDArray[np.int64]) -> NDArray[np.float64]:
    """Bring every iteration of a block (g, i, d) into the basis of some rows; see `to_basis`."""
    g, m, d = block.shape
    placed, axes, to_b2 = np.empty((g, m, d)), np.zeros((d, d)), np.zeros(d)
    for i in range(m):
        origin = block[basis[0], i]
        axes[0] = origin - block[basis[1], i]
        axes[0] /= np.sqrt((axes[0] ** 2).sum())
        if d == 2:
            axes[1, 0], axes[1, 1] = -axes[0, 1], axes[0, 0]
        else:
            to_b2 = block[basis[2], i] - origin
            axes[2] = to_b2 - (to_b2 * axes[0]).sum() * axes[0]
            axes[2] /= np.sqrt((axes[2] ** 2).sum())
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                axes[1, a] = axes[2, b] * axes[0, c] - axes[2, c] * axes[0, b]
        for k in range(g):
            for a in range(d):
                placed[k, i, a] = 0.0
                for b in range(d):
                    placed[k, i, a] += axes[a, b] * (block[k, i, b] - origin[b])
    return placed
