"""The consistent basis of a group of points, and its relative map (section III, Fig. 8)."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fixes_rotation


def choose_basis(points: Floats) -> Ints | None:
    """Choose well-separated basis points.

    B0 is the point farthest from the centre, B1 the farthest from B0, and in space B2 the farthest
    from the line through both.

    `points` (g, d): the group in one iteration. Returns (d,): rows of B0, B1 (and B2); None if the
    points coincide or, in space, are collinear.
    """
    if not fixes_rotation(points):
        return None
    b0 = int(np.argmax(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))
    from_b0 = points - points[b0]
    b1 = int(np.argmax(np.sum(from_b0**2, axis=1)))
    if points.shape[1] == 2:
        return np.array([b0, b1])
    along = from_b0[b1] / np.linalg.norm(from_b0[b1])
    across = from_b0 - np.outer(from_b0 @ along, along)
    return np.array([b0, b1, int(np.argmax(np.sum(across**2, axis=1)))])


def to_basis(block: Floats, basis: Ints) -> Floats:
    """Transform every iteration of a group into the consistent basis.

    B0 is the origin, B1 lies on the negative x axis, and in space B2 in the xz plane, at positive
    z.

    `block` (g, i, d), robot frame, metres; `basis` (d,): rows of B0, B1 (and B2). Returns
    (g, i, d), group frame, metres.
    """
    from relmap.points.basis_kernels import into_basis

    return into_basis(block, basis)


def relative_map(block: Floats) -> Floats | None:
    """Average a group's locations in its consistent basis (section III).

    `block` (g, i, d), robot frame, metres: every member seen in every iteration. Returns (g, d),
    group frame, metres, or None if the group determines no basis.
    """
    basis = choose_basis(block[:, block.shape[1] // 2])
    if basis is None:
        return None
    mean = to_basis(block, basis).mean(axis=1)
    return mean if np.isfinite(mean).all() else None
