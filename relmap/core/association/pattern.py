"""Steps along a pattern that repeats, as posts along a road, shelves or the windows of a house.

A placement a period away agrees nearly as well. From one scan to the next, a step of less than half
of the period is assumed; otherwise the scan is ambiguous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.association.chance import ENOUGH, PLENTY
from relmap.core.association.likelihood import LikelyPlacing
from relmap.core.association.placement import Placement
from relmap.core.association.scale import WIDER
from relmap.core.association.search import search, settled

SHORT = 0.25
"""Motion, in spacings, that is less than half of the period of any pattern."""
STEP, FEWER = 0.7, 1
"""Fraction of the possible matches that must agree on a step along a pattern, and by how many fewer
these may be than those of another placement, farther away."""


@dataclass(frozen=True, eq=False)
class PatternPlacing(LikelyPlacing):
    """Finds the step of the robot along a pattern."""

    def is_short(self, step_m: float) -> bool:
        """Return whether a motion is certainly less than half of the period of a pattern."""
        if step_m <= SHORT * self.scale.spacing_m:
            return True
        return step_m <= self.period_m(2 * step_m) / 2

    def step_m(self, placement: Placement) -> float:
        """Return how far a placement moves half of the tracks; infinite if not of the last scan."""
        from relmap.core.association.tracking_kernels import middle_step

        if self.tracks.missed.min() or self.idle:
            return np.inf
        return float(middle_step(self.tracks.expected, placement.R, placement.t))

    def next_step(self) -> Placement | None:
        """Return the step from one scan to the next along a pattern, by nearest neighbours.

        Other placements that match as well are at least half a period away. While the noise is
        unknown, more and more is assumed.
        """
        scale, known = self.scale, self.scale.noise_m is not None
        factors = (1.0,) if known else (1.0, *WIDER)
        for scale.wider in factors if self.possible >= PLENTY else ():
            found = self._step_by_neighbours()
            if found is not None:
                return found
        scale.wider = 1.0
        return None

    def _step_by_neighbours(self) -> Placement | None:
        """Return the placement on the nearest points if nearly all agree, and it is a step."""
        period_m, tolerance_m = self.period_m(), self.scale.tolerance_m
        if np.isinf(period_m):
            return None
        d, (here, there, own) = self.points.shape[1], self.crowd
        near: Placement | None = Placement(np.eye(d), np.zeros(d), 0)
        for reach_m in (max(tolerance_m, period_m / 3), tolerance_m):
            near = near and settled(here, there, near, reach_m, own)
        if near is None or near.n_agreeing < STEP * self.possible:
            return None
        if self.step_m(near) > period_m / 2:
            return None
        best = search(here, there, tolerance_m, ENOUGH, own)
        is_best = best is None or near.n_agreeing >= best[0].n_agreeing - FEWER
        return near if is_best and self.is_exceeded(near, here, there, 0) else None

    def period_m(self, within_m: float = np.inf) -> float:
        """Return the shortest period of tracks and points, metres; infinite without one.

        `within_m`: only shorter ones are tried.
        """
        from relmap.core.association.search_kernels import shortest_period

        shown, tolerance_m = (self.tracks.expected, self.points), self.scale.tolerance_m
        return min(shortest_period(each, tolerance_m, within_m) for each in shown)
