"""Whether the points of a 2-D laser scan are in the order of its beams."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats

APART = 0.5
"""Largest distance of successive points, as a fraction of that of points half the scan apart,
medians. In random order it is about 1; where half of the beams hit clutter it is 0.3."""
ONWARD = 0.75
"""Fraction of the beams that turn the same way about the robot; half of them in random order."""
LEAST = 50
"""Minimum number of points to judge by."""


def is_ordered(xy: Floats) -> bool:
    """Return whether points (n, 2), metres, may be in the order of beams, in either direction."""
    half = len(xy) // 2
    if len(xy) < LEAST:
        return True
    next_m, far_m = (
        float(np.median(np.linalg.norm(xy[step:] - xy[:-step], axis=1))) for step in (1, half)
    )
    turn = np.diff(np.unwrap(np.arctan2(xy[:, 1], xy[:, 0])))
    onward = max(float((turn > 0).mean()), float((turn < 0).mean()))
    return next_m <= APART * far_m or onward >= ONWARD
