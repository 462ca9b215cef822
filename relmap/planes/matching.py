"""Which walls of a scan are which tracks: normal, offset and gap along the wall (section II)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SIGMAS = 4.0
"""Tolerance, in standard deviations of what two walls differ by."""
TURN_RAD = np.deg2rad(8.0)
ACROSS_M = 0.12
GAP_M = 0.4
"""How far one wall may be off in two scans, whatever the noise: walls are not quite flat, and their
ends not quite where they are seen."""
WIDEST_TURN_RAD = 0.5
"""What noise may add to the tolerance of the turn at most."""
CLOSE = 0.3
BEYOND = 0.3
"""What a wall at the edge of a tolerance is worth less than one that agrees exactly."""


@dataclass(frozen=True, eq=False)
class Match:
    """Walls of a scan and the tracks that they continue, one to one.

    Attributes
    ----------
    tracks, walls : (k,) int64
    score : float
        How well they agree: each wall counts for 1 at most, each corner too.
    """

    tracks: NDArray[np.int64]
    walls: NDArray[np.int64]
    score: float
