"""The placement of live tracks in a scan with the most consistent matches, or none.

Nearest neighbours are tried first, then a search that is independent of the motion. A placement is
accepted if so many matches are unlikely by chance and no rival comes near.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.chance import (
    ENOUGH,
    LOG_CHANCE,
    LOG_CHANCE_NEAR,
    PLENTY,
    Chance,
    moved_m,
)
from relmap.core.association.metric import rows_of
from relmap.core.association.placement import DISTINCT, Placement, trimmed_fit
from relmap.core.association.scale import CHI2_MEDIAN, EXACT, SHARP, SIGMAS, SLOWNESS, WIDER, Scale
from relmap.core.association.search import fits_mirrored, search, settled
from relmap.core.association.soft import SoftMatching
from relmap.core.association.tracks import LiveTracks

NEAR_SHARE = 0.8
"""Fraction of the nearest neighbours that must agree to skip the wider search."""
DECIDABLE = 8
"""Minimum number of possible matches with which the likelihood decides between rivals."""
SHARE = 0.6
"""Fraction of the possible matches that must agree while the noise is unknown or the likelihood
decides."""
MISFIT = 2.0
"""Largest variance of their matches to skip it, relative to the usual one: if landmarks stand on a
lattice, the nearest neighbours may agree one period away, but less closely."""
SAMPLE = 32
"""Maximum number of tracks used to fit a placement; more would not improve it."""
CLEAR = 0.6
"""Fraction of the matches, or of the log likelihood ratio, that a rival may have."""
BLURRED = (0.1, 0.2, 0.35)
"""Noise, in spacings, that is tried where none explains the matches."""
ASIDE = 2.0
"""Largest shift of a rival of a placement found, in spacings."""
LEAST_MISFIT = 0.25
"""Minimum variance of matches relative to that assumed: with too much noise assumed, a rival nearby
would not differ."""
LOG_CLEAR = float(np.log(1 / 20))
"""Log of the likelihood of chance, or of a rival, relative to the most likely placement."""
FAMILIAR = 5
"""Observations of a landmark required if only two landmarks determine a planar scan."""
NEARBY = 0.2
"""Largest motion of these two, in spacings."""
BLIND = 8
"""Nearly empty scans after which any place may follow, also one that looks alike."""

Scored = tuple[Placement, float, float]
"""A placement, and the log likelihood ratios of it and of a rival."""


class _Searched(NamedTuple):
    """The placement found by a search, None if uncertain, and the matches of the best one.

    `is_doubtful` if that has rivals or fits less closely than usual, `is_ambiguous` if another one
    is almost as good.
    """

    placement: Placement | None
    n_agreeing: int
    is_doubtful: bool = False
    is_ambiguous: bool = False


@dataclass(frozen=True, eq=False)
class TrackPlacing:
    """Finds the placement of the tracks' frame in that of a scan.

    `chance`: with the scale of the scans so far, which each scan updates.
    """

    chance: Chance

    @property
    def scale(self) -> Scale:
        """Scale of the scans so far."""
        return self.chance.scale

    @property
    def metric(self) -> Floats | None:
        """Metric of the points of the scan (n, d, d)."""
        return self.chance.metric

    def placement(self, tracks: LiveTracks, points: Floats) -> Placement | None:
        """Return the placement that brings tracks onto points (n, d); None if none is certain."""
        learnt = self.scale.noise_m
        found, is_ambiguous = self._found(tracks, points)
        if self.scale.is_blurred:
            found = self._likely(tracks, points, found)
        if found is None:
            found = self._found_of_unknown_noise(tracks, points, is_ambiguous)
        if found is None or not self._is_elsewhere(found, learnt, tracks, points):
            return found
        self.scale.noise_m, self.scale.wider = learnt, 1.0
        return None

    def _is_elsewhere(
        self, found: Placement, learnt: float | None, tracks: LiveTracks, points: Floats
    ) -> bool:
        """Return whether the scan may show another place than the tracks.

        After many nearly empty scans, only if it shows nearly all tracks in place it does not.
        """
        if self.chance.idle > BLIND:
            share = NEAR_SHARE * min(len(tracks), len(points))
            has_moved = moved_m(found, tracks.expected) > self.scale.spacing_m
            return has_moved or found.n_agreeing < share
        return learnt is not None and self._is_mirrored(found, learnt, tracks, points)

    def _is_mirrored(
        self, found: Placement, learnt: float, tracks: LiveTracks, points: Floats
    ) -> bool:
        """Return whether the mirror image of a scan fits better than the scan at a large motion.

        In a mirrored scan, points near a plane fit all the same.
        """
        is_wide = self.scale.noise_m is None
        is_certain = not is_wide and found.n_agreeing >= SHARE * tracks.possible(points)
        if is_certain or moved_m(found, tracks.expected) <= self.scale.spacing_m:
            return False
        known, seen = tracks.crowd(points)
        tolerance_m = min(self.scale.tolerance_m, SIGMAS * learnt)
        least = found.n_agreeing if is_wide else found.n_agreeing / CLEAR
        own = rows_of(self.metric, seen)
        return fits_mirrored(tracks.expected[known], points[seen], tolerance_m, least, own)

    def is_unique(self, placement: Placement, tracks: LiveTracks, points: Floats) -> bool:
        """Return whether tracks fit points (n, d) better than chance explains in any placement."""
        chance = self.chance.log(placement.n_agreeing, tracks.expected, points)
        if self.scale.is_blurred:
            d, extent_m = points.shape[1], float(np.ptp(points, axis=0).max())
            chance = (2 * d - 3) * np.log(2 * np.pi) + self.chance.log_placements(d, extent_m)
            chance -= self._soft(tracks, points).fitted(placement.R, placement.t)[1]
        return bool(chance <= LOG_CHANCE)

    def _likely(
        self, tracks: LiveTracks, points: Floats, found: Placement | None
    ) -> Placement | None:
        """Return the most likely placement, near that found if there is one; None if uncertain."""
        matching, spacing_m = self._soft(tracks, points), self.scale.spacing_m
        here = matching.source
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
        chance = self.chance.log_placements(here.shape[1], far_m) - score
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

    def _soft(self, tracks: LiveTracks, points: Floats) -> SoftMatching:
        known, seen = tracks.crowd(points, len(tracks))
        variance, metric = self.scale.variances(tracks.seen[known]), rows_of(self.metric, seen)
        expected, spacing_m = tracks.expected[known], self.scale.spacing_m
        return SoftMatching(expected, variance, points[seen], spacing_m, metric)

    def _found(self, tracks: LiveTracks, points: Floats) -> tuple[Placement | None, bool]:
        """Find the placement of the tracks' frame in the scan with the most matches.

        Also returns whether it is None because several placements explain most of the scan.
        """
        from relmap.core.association.matching_kernels import matched_sample

        (n, d), metric = points.shape, self.metric
        sample, rows, target, distance, here, there, spacing_m = matched_sample(
            points, tracks.expected, tracks.missed, SAMPLE, self.scale.spacing_m, SLOWNESS
        )
        if not len(sample):
            return None, False
        self.scale.spacing_m = spacing_m
        missed, tolerance_m = int(tracks.missed[sample[0]]), self.scale.tolerance_m
        own = rows_of(metric, target)
        near = trimmed_fit(here, there, tolerance_m, own)
        is_sharp = tolerance_m <= SHARP * spacing_m
        share = NEAR_SHARE * min(len(sample), n)
        if near is not None:
            is_usual = (
                is_sharp and not missed and self._is_usual(near, here, there, tolerance_m, own)
            )
            if is_usual and near.n_agreeing >= max(PLENTY, share):
                return near, False
            alone = near.n_agreeing == len(rows) == d == 2
            if alone and self._is_familiar_pair(tracks, rows, distance):
                return near, False
            here = tracks.expected[sample]
            near = settled(here, points, near, tolerance_m, metric)
            if near is not None and not self.chance.is_exceeded(near, here, points, missed):
                near = None
        if near is not None and is_usual and near.n_agreeing >= share:
            return near, False
        far = self._search(tracks, points)
        is_best = is_sharp and near is not None and far.n_agreeing <= near.n_agreeing
        if near and is_best and (near.n_agreeing >= share or not far.is_doubtful):
            return near, False
        explains = far.n_agreeing >= SHARE * tracks.possible(points)
        return far.placement, far.placement is None and far.is_ambiguous and explains

    def _is_usual(
        self,
        placement: Placement,
        here: Floats,
        there: Floats,
        tolerance_m: float,
        metric: Floats | None,
    ) -> bool:
        """Return whether matches of tracks (n, d) and points (n, d) scatter as they usually do."""
        from relmap.core.association.matching_kernels import middle_square

        if self.scale.noise_m is None:
            return False
        R, t = placement.R, placement.t
        variance = middle_square(here, there, R, t, tolerance_m, metric) / CHI2_MEDIAN[len(t)]
        usual_m = max(self.scale.noise_m, EXACT / SIGMAS * self.scale.spacing_m)
        return bool(variance <= MISFIT * usual_m**2)

    def _is_familiar_pair(self, tracks: LiveTracks, rows: Ints, distance: Floats) -> bool:
        """Return whether two matches in the plane suffice: well known, just seen, hardly moved."""
        known = (tracks.seen[rows] >= FAMILIAR).all() and (tracks.missed[rows] == 0).all()
        return bool(known and distance.max() <= NEARBY * self.scale.spacing_m)

    def _found_of_unknown_noise(
        self, tracks: LiveTracks, points: Floats, is_ambiguous: bool
    ) -> Placement | None:
        """Retry as if the noise were unknown: it may have grown, as when a robot starts moving.

        If several placements explain the scan, more noise would only hide that.
        """
        widest_m = self.scale.tolerance_m if is_ambiguous else np.inf
        scale, possible = self.scale, tracks.possible(points)
        learnt, scale.noise_m = scale.noise_m, None
        for scale.wider in WIDER if possible >= PLENTY else ():
            is_new = scale.wider != 1 if learnt is None else scale.tolerance_m > SIGMAS * learnt
            if is_new and scale.tolerance_m < widest_m:
                placement, _ = self._found(tracks, points)
                if placement is not None and placement.n_agreeing >= SHARE * possible:
                    return placement
        scale.wider = 1.0
        scale.noise_m = learnt
        may_be_blurred = learnt is None or scale.is_blurred
        for share in BLURRED if possible >= PLENTY and may_be_blurred else ():
            scale.noise_m = share * scale.spacing_m
            is_new = scale.noise_m >= (learnt or 0) and SIGMAS * scale.noise_m < widest_m
            if scale.is_blurred and is_new:
                matching, placement = self._soft(tracks, points), self._likely(tracks, points, None)
                if placement is not None and matching.misfit(placement) >= LEAST_MISFIT:
                    return placement
        scale.noise_m = learnt
        return None

    def _search(self, tracks: LiveTracks, points: Floats) -> _Searched:
        """Search for the tracks in the scan, for any motion of the robot.

        If there are many, only those near the robot are used. Between rivals with similar numbers
        of matches the likelihood decides, if the noise is known.
        """
        missed, (known, seen) = int(tracks.missed.min()), tracks.crowd(points)
        here, there = tracks.expected[known], points[seen]
        found = search(here, there, self.scale.tolerance_m, ENOUGH, rows_of(self.metric, seen))
        if found is None:
            return _Searched(None, 0)
        placement, rival = found
        if not self.chance.is_exceeded(placement, here, there, missed):
            return _Searched(None, placement.n_agreeing)
        is_decidable = self.scale.noise_m is not None
        is_decidable &= min(len(here), len(there)) >= DECIDABLE
        # Matches that chance produces in some placement explain nothing.
        is_clear = rival <= CLEAR * placement.n_agreeing or self.chance.log(rival, here, there) > 0
        if is_clear and (
            not is_decidable or self._soft(tracks, points).misfit(placement) <= MISFIT
        ):
            return _Searched(placement, placement.n_agreeing)
        likely = self._likely(tracks, points, None) if is_decidable else None
        near = tracks.crowd(points, len(tracks))[0]
        if likely is not None and likely.n_agreeing < SHARE * min(len(near), len(there)):
            likely = None  # the best one may not be among those suggested
        comes_near = not is_clear and rival > DISTINCT * placement.n_agreeing
        return _Searched(likely, placement.n_agreeing, True, comes_near)
