"""Whether the points of a 2-D laser scan are in the order of its beams."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError

APART = 0.5
"""Largest distance of successive points, as a fraction of that of points half the scan apart,
medians. In random order it is about 1; where half of the beams hit clutter it is 0.3."""
LEAST = 50
"""Minimum number of points to judge by."""


def require_order(xy: Floats) -> None:
    """Check that points (n, 2), metres, are ordered by beam, in either direction.

    Raises
    ------
    RelmapError
        If they are not.
    """
    half = len(xy) // 2
    if len(xy) < LEAST:
        return
    next_m, far_m = (
        float(np.median(np.linalg.norm(xy[step:] - xy[:-step], axis=1))) for step in (1, half)
    )
    if next_m > APART * far_m:
        raise RelmapError(
            "the points of a scan are not in the order of the beams, as a 2-D laser returns them; "
            "sort those of each scan by bearing, or choose the segmenter em, which needs no order"
        )
