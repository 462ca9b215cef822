"""Residuals of observations along a chain of poses, and their Jacobians, compiled."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled


@compiled
def left_of_seen(
    points: Floats,
    root: Floats,
    iteration: Ints,
    landmark: Ints,
    R: Floats,
    t: Floats,
    positions: Floats,
    left: Floats,
    jacobian: Floats,
) -> None:
    """Compute the residuals (n, d) of observations, and their Jacobian (n, d, 3 d - 3 + d).

    By a motion of the robot, as of `derivatives`, and by the position of the landmark. See `Chain`
    and `Chained` for the other arguments.
    """
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
            left[k, a] = 0.0
            for b in range(d):
                left[k, a] += root[k, a, b] * off[b]
            for c in range(d):
                by_landmark = 0.0
                for b in range(d):
                    by_landmark += root[k, a, b] * R[at, c, b]
                jacobian[k, a, q + c] = -by_landmark
                jacobian[k, a, q + d + c] = by_landmark
            # The landmark moves across its ray.
            for c in range(q):
                b, e = (0, 1) if d == 2 else ((c + 1) % 3, (c + 2) % 3)
                by = jacobian[k, a, q:]
                jacobian[k, a, c] = by[e] * away[b] - by[b] * away[e]
