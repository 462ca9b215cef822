"""Small motions of points: their Jacobians, and the rotations that they are."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats


def derivatives(away: Floats) -> Floats:
    """Return the Jacobians (n, d, q) of points by a motion; (n, d) from the centre."""
    n, d = away.shape
    J = np.zeros((n, d, 3 * d - 3))
    J[:, :, -d:] = np.eye(d)
    if d == 2:
        J[:, 0, 0], J[:, 1, 0] = -away[:, 1], away[:, 0]
    else:
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            J[:, a, b], J[:, a, c] = away[:, c], -away[:, b]
    return J


def rotations(turns: Floats) -> Floats:
    """Return the rotations (n, d, d) for angles (n, 1) or rotation vectors (n, 3)."""
    if turns.shape[1] == 3:
        return np.asarray(Rotation.from_rotvec(turns).as_matrix())
    cos, sin = np.cos(turns[:, 0]), np.sin(turns[:, 0])
    return np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)


def transforms(R: Floats, t: Floats) -> Floats:
    """Return rotations (..., d, d) and translations (..., d) as matrices (..., 4, 4)."""
    d, T = t.shape[-1], np.empty((*t.shape[:-1], 4, 4))
    T[:] = np.eye(4)
    T[..., :d, :d], T[..., :d, 3] = R, t
    return T
