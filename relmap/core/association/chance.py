"""How many placements would match as well by chance (Desolneux, Moisan and Morel, 2000)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.association.placement import Placement
from relmap.core.association.scale import Scale
from relmap.core.association.search import log_chance
from relmap.core.geometry.alignment import extent_of

ENOUGH = 3
"""Minimum number of matches: two distances agree by chance occasionally, three rarely."""
PLENTY = 6
"""Number of matches whose agreement is never due to chance."""
FAR_SHARE = 0.3
"""Fraction of possible matches that must agree after a large motion."""
LOG_CHANCE, LOG_CHANCE_NEAR = float(np.log(1e-3)), float(np.log(1e-2))
"""Log of the accepted rate of wrong placements, in general and after little motion."""


@dataclass(frozen=True, eq=False)
class Chance:
    """The matches that chance produces between tracks and the points of a scan.

    `scale`: scale of the scans so far; `idle`: nearly empty scans since the tracks were seen;
    `metric` (n, d, d): of the points of the scan.
    """

    scale: Scale
    idle: int
    metric: Floats | None

    def is_exceeded(self, placement: Placement, here: Floats, there: Floats, missed: int) -> bool:
        """Return whether a placement of tracks (n, d) on points (m, d) is better than by chance.

        After failed attempts and nearly empty scans, more matches are required, and as many after
        little motion as after much: the robot may have moved far meanwhile.
        """
        enough = ENOUGH + max(missed, min(missed + self.idle, PLENTY - ENOUGH))
        far_m = moved_m(placement, here)
        if placement.n_agreeing < enough:
            return False
        if far_m <= self.scale.spacing_m and not missed:
            return self.log(placement.n_agreeing, here, there, far_m) <= LOG_CHANCE_NEAR
        if placement.n_agreeing < FAR_SHARE * min(len(here), len(there)):
            return False
        doublings = 1 + np.log2(max(far_m / self.scale.spacing_m, 1.0))
        chance = self.log(placement.n_agreeing, here, there, far_m)
        return bool(chance + np.log(doublings) <= LOG_CHANCE)

    def log(
        self, n_agreeing: int, here: Floats, there: Floats, far_m: float | None = None
    ) -> float:
        """Return the log of the expected number of placements that match as many tracks by chance.

        Placements are counted in steps of the tolerance: those with no larger motion, or all.
        """
        tolerance_m, d, placements = self.scale.tolerance_m, here.shape[1], 0.0
        if far_m is None:
            far_m = extent_of(there)
            placements = (2 * d - 3) * math.log(2 * math.pi)
        placements += self.log_placements(d, far_m)
        # The volume of a gate relative to that of a sphere, on average over the points.
        volume = 1.0 if self.metric is None else float(np.mean(1 / np.linalg.det(self.metric)))
        share = min(math.log(2) * volume * (tolerance_m / self.scale.spacing_m) ** d, 0.5)
        n = max(min(len(here), len(there)), n_agreeing)
        return log_chance(n, n_agreeing, share, placements)

    def reach_m(self, far_m: float, d: int) -> float:
        """Return the motion up to which there are a thousand times as many placements."""
        factor, half_m = math.exp(-LOG_CHANCE * 2 / (d * (d + 1))), self.scale.tolerance_m / 2
        return factor * (far_m + half_m) - half_m

    def log_placements(self, d: int, far_m: float) -> float:
        """Return the log of the number of placements that move no point farther."""
        return d * (d + 1) / 2 * math.log(1 + 2 * far_m / self.scale.tolerance_m)


def moved_m(placement: Placement, points: Floats) -> float:
    """Return the largest distance by which a placement moves points (n, d), metres."""
    return float(np.linalg.norm(placement.apply(points) - points, axis=1).max())
