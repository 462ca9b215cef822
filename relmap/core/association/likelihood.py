"""The most likely placement of live tracks in a scan, where single matches are ambiguous."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.association.chance import LOG_CHANCE_NEAR, Chance, moved_m
from relmap.core.association.metric import rows_of
from relmap.core.association.placement import Placement
from relmap.core.association.soft import SoftMatching
from relmap.core.association.tracks import SEARCH, LiveTracks

SHARE = 0.6
"""Fraction of the possible matches that must agree while the noise is unknown or the likelihood
decides."""
CLEAR = 0.6
"""Fraction of the matches, or of the log likelihood ratio, that a rival may have."""
ASIDE = 2.0
"""Largest shift of a rival of a placement found, in spacings."""
LOG_CLEAR = float(np.log(1 / 20))
"""Log of the likelihood of chance, or of a rival, relative to the most likely placement."""

Scored = tuple[Placement, float, float]
"""A placement, and the log likelihood ratios of it and of a rival."""


@dataclass(frozen=True, eq=False)
class LikelyPlacing(Chance):
    """Finds the most likely placement of the tracks' frame in that of a scan.

    Each scan updates the scale. `points` (n, d), robot frame, metres: those of the scan.
    """

    tracks: LiveTracks
    points: Floats

    def likely(self, found: Placement | None) -> Placement | None:
        """Return the most likely placement, near that found if there is one; None if uncertain."""
        matching, spacing_m = self.soft, self.scale.spacing_m
        here = matching.source
        if not len(here):  # all tracks are farther away than the crowd
            return None
        if found is None or moved_m(found, here) > spacing_m:
            best = matching.found(*matching.by_triangles())
            near = matching.found(*matching.by_shifts(ASIDE * spacing_m))
            if near and self._is_clear(near, best, matching):
                best = near  # triangles are those of a few tracks only
        else:
            best = matching.found(*matching.by_shifts(ASIDE * spacing_m, found))
        if best is None:
            return None
        placement, score, rival = best
        far_m = moved_m(placement, here)
        chance = self.log_placements(here.shape[1], far_m) - score
        if chance > (LOG_CLEAR if far_m <= spacing_m else LOG_CHANCE_NEAR):
            return None
        if rival > min(score + LOG_CLEAR, CLEAR * score):
            return None
        if self.scale.is_blurred:  # otherwise it is learnt from the links
            self.scale.learn_misfit(matching.misfit(placement))
        return placement

    @staticmethod
    def _is_clear(near: Scored, best: Scored | None, matching: SoftMatching) -> bool:
        """Return whether a placement is clearly more likely than another, or explains the scan."""
        if best is None:
            return near[0].n_agreeing >= SHARE * min(len(matching.source), len(matching.target))
        return CLEAR * near[1] > best[1]

    @cached_property
    def possible(self) -> int:
        """Number of matches that a search may find."""
        n_recent = len(self.tracks) - int(np.count_nonzero(self.tracks.missed))
        return min(n_recent, len(self.points), SEARCH)

    @cached_property
    def crowd(self) -> tuple[Floats, Floats, Floats | None]:
        """Tracks (k, d) and points (l, d) that a search uses, and the metric (l, d, d) of these."""
        known, seen = self.tracks.crowd(self.points)
        return self.tracks.expected[known], self.points[seen], rows_of(self.metric, seen)

    @property
    def soft(self) -> SoftMatching:
        """Tracks and points for the search of the most likely placement, with the noise as now."""
        tracks, spacing_m = self.tracks, self.scale.spacing_m
        known, seen = tracks.crowd(self.points, len(tracks))
        variance, metric = self.scale.variances(tracks.seen[known]), rows_of(self.metric, seen)
        return SoftMatching(tracks.expected[known], variance, self.points[seen], spacing_m, metric)
