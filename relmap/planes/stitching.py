"""The path over everything, where the map alone does not tie it: the motion model.

Where too little is at rest in view, as along a single partial wall, the map falls into pieces.  How
far the robot went from one scan to the next is known all the same, roughly: across a wall and in
turn from what was seen, along it by going on as before (`placement`).  Such links are weak: they
say where a piece is to begin with, and nothing in what is refined afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def stitched(
    pieces: Sequence[NDArray[np.float64]], motions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the path in the frame of the first piece.

    Parameters
    ----------
    pieces : sequence of (n, 4, 4) float64
        ``T_piece_robot`` of every iteration in each piece, the most important one first; NaN where
        an iteration is not fixed in it.
    motions : (n, 3) float64
        yaw, x, y of the motion from the robot frame before into that of each iteration.

    Returns
    -------
    (n, 4, 4) float64
        ``T_map_robot``; all NaN where no piece fixes any.
    """
    n = len(motions)
    steps = np.linalg.inv(_matrices(motions))
    poses = np.full((n, 4, 4), np.nan)
    piece = np.full(n, -1)
    for number, own in enumerate(pieces):
        free = (piece < 0) & np.isfinite(own[:, 0, 0])
        piece[free], poses[free] = number, own[free]
    fixed = np.flatnonzero(piece == 0)
    if not len(fixed):
        return np.full((n, 4, 4), np.nan)
    placed = {0: np.eye(4)}
    for i in range(fixed[0] + 1, n):
        poses[i] = _placed(placed, piece[i], poses[i], poses[i - 1] @ steps[i])
    for i in reversed(range(fixed[0])):
        back = poses[i + 1] @ np.linalg.inv(steps[i + 1])
        poses[i] = _placed(placed, piece[i], poses[i], back)
    return poses


def _placed(
    placed: dict[int, NDArray[np.float64]],
    piece: int,
    own: NDArray[np.float64],
    expected: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the pose of an iteration; place its piece where it is expected if it is not yet."""
    if piece < 0:
        return expected
    if piece not in placed:
        placed[piece] = expected @ np.linalg.inv(own)
    return np.asarray(placed[piece] @ own)


def _matrices(motions: NDArray[np.float64]) -> NDArray[np.float64]:
    T = np.tile(np.eye(4), (len(motions), 1, 1))
    c, s = np.cos(motions[:, 0]), np.sin(motions[:, 0])
    T[:, 0, 0] = T[:, 1, 1] = c
    T[:, 1, 0], T[:, 0, 1] = s, -s
    T[:, :2, 3] = motions[:, 1:]
    return T
