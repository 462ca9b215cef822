"""The planar motion that brings one path onto another by turn and place, however short it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def fit_poses(
    poses: NDArray[np.float64], others: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the planar motion R (2, 2), t (2,) that brings poses (k, 4, 4) onto others best.

    The turn is the mean one of the poses, so that one pose is enough.
    """
    turn = np.einsum("kij,klj->il", others[:, :2, :2], poses[:, :2, :2])
    angle = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return R, (others[:, :2, 3] - poses[:, :2, 3] @ R.T).mean(axis=0)
