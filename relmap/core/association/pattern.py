"""Steps along a pattern that repeats, as posts along a road, shelves or the windows of a house.

A placement a period away agrees nearly as well. From one scan to the next, a step of less than half
of the period is assumed; otherwise the scan is ambiguous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.association.chance import ENOUGH, PLENTY
from relmap.core.association.likelihood import LikelyPlacing
from relmap.core.association.metric import rows_of
from relmap.core.association.placement import Placement
from relmap.core.association.scale import WIDER
from relmap.core.association.search import period_of, search, settled
from relmap.core.association.tracks import LiveTracks

SHORT = 0.25
"""Motion, in spacings, that is less than half of the period of any pattern."""
STEP, FEWER = 0.7, 1
"""Fraction of the possible matches that must agree on a step along a pattern, and by how many fewer
these may be than those of another placement, farther away."""


@dataclass(frozen=True, eq=False)
class PatternPlacing(LikelyPlacing):
    """Finds the step of the robot along a pattern."""

    def is_safe(self, placement: Placement, tracks: LiveTracks, points: Floats) -> bool:
        """Return whether a placement is not a period of a pattern off.

        From one scan to the next, a step of less than half of the period is assumed.
        """
        return self._is_short(self._step_m(placement, tracks), tracks, points)

    def _is_short(self, step_m: float, tracks: LiveTracks, points: Floats) -> bool:
        """Return whether a motion is certainly less than half of the period of a pattern."""
        if step_m <= SHORT * self.scale.spacing_m:
            return True
        return step_m <= self.period_m(tracks, points, 2 * step_m) / 2

    def _step_m(self, placement: Placement, tracks: LiveTracks) -> float:
        """Return how far a placement moves half of the tracks; infinite if not of the last scan."""
        from relmap.core.association.tracking_kernels import middle_step

        if tracks.missed.min() or self.idle:
            return np.inf
        return float(middle_step(tracks.expected, placement.R, placement.t))

    def next_step(self, tracks: LiveTracks, points: Floats) -> Placement | None:
        """Return the step from one scan to the next along a pattern, by nearest neighbours.

        Other placements that match as well are at least half a period away. While the noise is
        unknown, more and more is assumed.
        """
        scale, known = self.scale, self.scale.noise_m is not None
        factors = (1.0,) if known else (1.0, *WIDER)
        for scale.wider in factors if tracks.possible(points) >= PLENTY else ():
            found = self._step_by_neighbours(tracks, points)
            if found is not None:
                return found
        scale.wider = 1.0
        return None

    def _step_by_neighbours(self, tracks: LiveTracks, points: Floats) -> Placement | None:
        """Return the placement on the nearest points if nearly all agree, and it is a step."""
        period_m, tolerance_m = self.period_m(tracks, points), self.scale.tolerance_m
        if np.isinf(period_m):
            return None
        d, (known, seen) = points.shape[1], tracks.crowd(points)
        here, there, own = tracks.expected[known], points[seen], rows_of(self.metric, seen)
        near: Placement | None = Placement(np.eye(d), np.zeros(d), 0)
        for reach_m in (max(tolerance_m, period_m / 3), tolerance_m):
            near = near and settled(here, there, near, reach_m, own)
        if near is None or near.n_agreeing < STEP * tracks.possible(points):
            return None
        if self._step_m(near, tracks) > period_m / 2:
            return None
        best = search(here, there, tolerance_m, ENOUGH, own)
        is_best = best is None or near.n_agreeing >= best[0].n_agreeing - FEWER
        return near if is_best and self.is_exceeded(near, here, there, 0) else None

    def period_m(self, tracks: LiveTracks, points: Floats, within_m: float = np.inf) -> float:
        """Return the shortest period of tracks and points (n, d), metres; infinite without one.

        `within_m`: only shorter ones are tried.
        """
        shown, tolerance_m = (tracks.expected, points), self.scale.tolerance_m
        return min(period_of(each, tolerance_m, within_m) for each in shown)
