"""Fitting a group's relative map to the global map, compiled; see `globalmap`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.fitting_kernels import scatter_of, swings
from relmap.core.geometry.rotation_kernels import best_rotation, fixes
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.small_kernels import identity
from relmap.core.map.globalmap import LOOSE

Columns = tuple[Floats, Floats, Ints]
"""Of the landmark table: position, weight, submap."""


@helper
def _weighted(source: Floats, target: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return weighted means (2, 3) and cross moment (3, 3) of matched points (n, d)."""
    (n, d), means, moment, total = source.shape, np.zeros((2, 3)), np.zeros((3, 3)), 0.0
    for i in range(n):
        total += weights[i]
    for i in range(n):
        for a in range(d if weights[i] > 0 else 0):
            means[0, a] += weights[i] / total * source[i, a]
            means[1, a] += weights[i] / total * target[i, a]
    for i in range(n):
        for a in range(d if weights[i] > 0 else 0):
            away = weights[i] / total * (source[i, a] - means[0, a])
            for b in range(d):
                moment[a, b] += away * (target[i, b] - means[1, b])
    return means, moment


@compiled
def aligned(
    columns: Columns, submap: int, landmarks: Ints, relative: Floats, counts: Ints
) -> tuple[Floats, bool]:
    """Return a relative map (n, d) in the frame of a submap; see `GlobalMap.align`.

    `counts` (n,): iterations averaged into it. Returns also whether the rotation is determined.
    """
    position, weight, submap_of = columns
    (n, d), there, placed = relative.shape, np.empty(relative.shape), np.empty(relative.shape)
    weights, rows = np.zeros(n), np.empty(n, dtype=np.bool_)
    for i in range(n):
        one = landmarks[i]
        if submap_of[one] == submap:
            weights[i] = weight[one] * counts[i] / (weight[one] + counts[i])
        rows[i] = weights[i] > 0
        for a in range(d):
            there[i, a] = position[one, a]
    means, moment = _weighted(relative, there, weights)
    R, swing = best_rotation(moment, identity(d)), swings(relative, rows)
    for i in range(n):
        for a in range(d):
            placed[i, a] = means[1, a] if swing[i] <= LOOSE else np.nan
            for b in range(d):
                placed[i, a] += R[a, b] * (relative[i, b] - means[0, b])
    return placed, fixes(scatter_of(there, rows)[0], d)
