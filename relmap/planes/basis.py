"""The consistent basis of a group of corners and midpoints, and its relative map (Figs 1, 2)."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.alignment import fixes_rotation


def relative_map(block: Floats) -> Floats | None:
    """Average a group's locations in a basis invariant to rotation and translation.

    Every iteration is rotated so that the line through the two points farthest apart is at 0
    degrees, and then averaged. If there is only one wall, the pair lies on it, as in Fig. 2; the
    larger the distance, the smaller the effect of noise on the rotation.

    Parameters
    ----------
    block : (g, i, 2) float64, robot frame, metres
        Every member seen in every iteration.

    Returns
    -------
    (g, 2) float64, group frame, metres, or None if the group determines no basis
    """
    middle = block[:, block.shape[1] // 2]
    if not fixes_rotation(middle):
        return None
    apart = np.linalg.norm(middle[:, None] - middle, axis=2)
    first, second = np.unravel_index(np.argmax(apart), apart.shape)
    axis = block[second] - block[first]
    length = np.linalg.norm(axis, axis=1)
    fixed = length > 0  # two ends may coincide
    axis = axis[fixed] / length[fixed, None]
    relative = (block - block[first])[:, fixed]
    x = (relative * axis).sum(axis=2)
    y = relative[..., 1] * axis[:, 0] - relative[..., 0] * axis[:, 1]
    return np.stack([x.mean(axis=1), y.mean(axis=1)], axis=1)
