"""Whether the points of a 2-D laser scan are in the order of its beams."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError

LEAST_SHARE = 0.75
"""Minimum fraction of steps from point to point in the same direction of rotation. Of points in
random order it is about one half; nearly all steps of a laser that is not at the origin agree."""
LEAST = 50
"""Minimum number of steps to judge by."""


def require_order(xy: Floats) -> None:
    """Check that points (n, 2), robot frame, metres, are ordered by beam, in either direction.

    Raises
    ------
    RelmapError
        If they are not.
    """
    turn = np.diff(np.arctan2(xy[:, 1], xy[:, 0]))
    turn = np.mod(turn + np.pi, 2 * np.pi) - np.pi
    left, right = np.sum(turn > 0), np.sum(turn < 0)
    if left + right >= LEAST and max(left, right) < LEAST_SHARE * (left + right):
        raise RelmapError(
            "the points of a scan are not in the order of the beams, as a 2-D laser returns them; "
            "sort those of each scan by bearing, or choose the segmenter em, which needs no order"
        )
