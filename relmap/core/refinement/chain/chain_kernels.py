"""Residuals of observations along a chain of poses, and their Jacobians, compiled."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled

Seen = tuple[Floats, Floats, Ints, Ints]
"""points, root, iteration, landmark: see `Chain`."""


@compiled
def left_of_seen(
    seen: Seen, R: Floats, t: Floats, positions: Floats, left: Floats, jacobian: Floats
) -> None:
    """Compute the residuals (n, d) of observations, and their Jacobian (n, d, q + 2 d).

    By the turn and shift of the robot, as of `derivatives`, and by the position of the landmark.
    """
    points, root, iteration, landmark = seen
    (n, d), q = points.shape, jacobian.shape[2] - 2 * points.shape[1]
    away, off = np.empty(d), np.empty(d)
    for k in range(n):
        at = iteration[k]
        for a in range(d):
            away[a] = positions[landmark[k], a] - t[at, a]
        for a in range(d):
            off[a] = -points[k, a]
            for b in range(d):
                off[a] += R[at, b, a] * away[b]
        for a in range(d):
            row, left[k, a] = jacobian[k, a], 0.0
            for b in range(d):
                left[k, a] += root[k, a, b] * off[b]
            for c in range(d):
                row[q + d + c] = 0.0
                for b in range(d):
                    row[q + d + c] += root[k, a, b] * R[at, c, b]
                row[q + c] = -row[q + d + c]
            for c in range(q):  # A turn moves the landmark across its ray.
                b, e = (0, 1) if d == 2 else ((c + 1) % 3, (c + 2) % 3)
                row[c] = row[q + e] * away[b] - row[q + b] * away[e]
