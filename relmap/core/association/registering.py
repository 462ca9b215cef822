"""The placement of live tracks in a scan with the most consistent matches, or none.

Nearest neighbours are tried first, then a search that is independent of the motion. A placement is
accepted if so many matches are unlikely by chance and no rival comes near.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.chance import ENOUGH, LOG_CHANCE, PLENTY, moved_m
from relmap.core.association.likelihood import CLEAR, SHARE
from relmap.core.association.metric import rows_of
from relmap.core.association.pattern import PatternPlacing
from relmap.core.association.placement import DISTINCT, Placement, trimmed_fit
from relmap.core.association.scale import (
    CHI2_MEDIAN,
    COARSE,
    FINER,
    SHARP,
    SIGMAS,
    SLOWNESS,
    WIDER,
)
from relmap.core.association.search import fits_mirrored, search, settled
from relmap.core.geometry.alignment import extent_of

NEAR_SHARE = 0.8
"""Fraction of the nearest neighbours that must agree to skip the wider search."""
DECIDABLE = 8
"""Minimum number of possible matches with which the likelihood decides between rivals."""
MISFIT = 2.0
"""Largest variance of their matches to skip it, relative to the usual one: if landmarks stand on a
lattice, the nearest neighbours may agree one period away, but less closely."""
SAMPLE = 32
"""Maximum number of tracks used to fit a placement; more would not improve it."""
BLURRED = (0.1, 0.2, 0.35)
"""Noise, in spacings, that is tried where none explains the matches."""
GROWN = 2.5
"""Largest noise tried, relative to that learnt from the scans before."""
FAMILIAR = 5
"""Observations of a landmark required if only two landmarks determine a planar scan."""
NEARBY = 0.2
"""Largest motion of these two, in spacings, over all scans since they were seen."""
LEAP, FAR, SLOWLY = 4.0, 0.3, 1.2
"""Multiple of the longest step so far, and fraction of the median distance of the points, beyond
both of which a step is a leap; and factor by which each leap lengthens the longest step."""
BLIND = 8
"""Nearly empty scans after which any place may follow, also one that looks alike."""


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
class TrackPlacing(PatternPlacing):
    """Finds the placement of the tracks' frame in that of a scan, of any noise."""

    def placement(self) -> Placement | None:
        """Return the placement that brings tracks onto points; None if none is certain."""
        learnt, is_ambiguous, found = self.scale.noise_m, False, None
        if learnt is None and np.isfinite(self.period_m()):
            found = self._explaining(FINER, np.inf)
        if found is None:
            found, is_ambiguous = self._found()
        if self.scale.is_blurred:
            found = self.likely(found)
        if found is None:
            found = self.next_step()
        if found is None:
            # In a pattern that repeats, more noise would hide that it fits a period away as well.
            is_ambiguous |= learnt is not None and np.isfinite(self.period_m())
            found = self._found_of_unknown_noise(is_ambiguous)
        if found is None or not self._is_elsewhere(found, learnt):
            return found
        self.scale.noise_m, self.scale.wider = learnt, 1.0
        return None

    def _is_elsewhere(self, found: Placement, learnt: float | None) -> bool:
        """Return whether the scan may show another place than the tracks.

        In a pattern that repeats, a few matches may be anywhere, also the other way round.
        After many nearly empty scans, only if it shows nearly all tracks in place it does not.
        """
        if found.n_agreeing < PLENTY and not self.is_short(self.step_m(found)):
            return True
        if self._leaps(found):
            return True
        if self.idle > BLIND:
            share = NEAR_SHARE * min(len(self.tracks), len(self.points))
            has_moved = moved_m(found, self.tracks.expected) > self.scale.spacing_m
            return has_moved or found.n_agreeing < share
        return learnt is not None and self._is_mirrored(found, learnt)

    def _leaps(self, found: Placement) -> bool:
        """Note the step of the robot; return whether it is far too long for what matches.

        A place that looks like an earlier one may be taken for it. If all possible matches agree,
        no step is too long. A robot that stays as fast is followed after some scans.
        """
        n_scans, longest_m = 1 + self.idle + int(self.tracks.missed.min()), self.scale.step_m
        step_m = float(np.linalg.norm(found.t)) / n_scans
        near_m = FAR * float(np.median(np.linalg.norm(self.points, axis=1)))
        usual_m = max(longest_m, near_m / LEAP)
        is_far = step_m > LEAP * usual_m and longest_m > 0
        self.scale.step_m = max(longest_m, SLOWLY * usual_m if is_far else step_m)
        return is_far and found.n_agreeing < min(len(self.tracks), len(self.points))

    def _is_mirrored(self, found: Placement, learnt: float) -> bool:
        """Return whether the mirror image of a scan fits better than the scan at a large motion.

        In a mirrored scan, points near a plane fit all the same.
        """
        is_wide = self.scale.noise_m is None
        is_certain = not is_wide and found.n_agreeing >= SHARE * self.possible
        if is_certain or moved_m(found, self.tracks.expected) <= self.scale.spacing_m:
            return False
        here, there, own = self.crowd
        tolerance_m = min(self.scale.tolerance_m, SIGMAS * learnt)
        least = found.n_agreeing if is_wide else found.n_agreeing / CLEAR
        return fits_mirrored(here, there, tolerance_m, least, own)

    def is_unique(self, placement: Placement) -> bool:
        """Return whether tracks fit the points better than chance explains in any placement."""
        chance = self.log(placement.n_agreeing, self.tracks.expected, self.points)
        if self.scale.is_blurred:
            d, extent_m = self.points.shape[1], extent_of(self.points)
            chance = (2 * d - 3) * np.log(2 * np.pi) + self.log_placements(d, extent_m)
            chance -= self.soft.fitted(placement.R, placement.t)[1]
        return bool(chance <= LOG_CHANCE)

    def _found(self) -> tuple[Placement | None, bool]:
        """Find the placement of the tracks' frame in the scan with the most matches.

        Also returns whether it is None because several placements explain most of the scan.
        """
        import relmap.core.association.matching_kernels as matching
        import relmap.core.association.tracking_kernels as tracking

        tracks, points, metric, scale = self.tracks, self.points, self.metric, self.scale
        n, d = points.shape
        sample, rows, target, distance, here, there, spacing_m = matching.matched_sample(
            points, tracks.expected, tracks.missed, SAMPLE, scale.spacing_m, SLOWNESS
        )
        if not len(sample) or spacing_m == 0:
            return None, False
        scale.spacing_m = spacing_m
        missed, tolerance_m = int(tracks.missed[sample[0]]), scale.tolerance_m
        own = rows_of(metric, target)
        near = trimmed_fit(here, there, tolerance_m, own)
        is_sharp = tolerance_m <= SHARP * spacing_m
        share, pair = NEAR_SHARE * min(len(sample), n), None
        if near is not None:
            of = (here, there), tracks.expected, (near.R, near.t)
            square, step_m = tracking.agreement(*of, tolerance_m, own)
            is_usual = (scale.noise_m is not None and is_sharp and not missed) and (
                square / CHI2_MEDIAN[d] <= MISFIT * scale.assumed_m**2
            )
            is_safe = self.is_short(np.inf if missed or self.idle else step_m)
            if is_safe and is_usual and near.n_agreeing >= max(PLENTY, share):
                return near, False
            pair = near if self._is_familiar_pair(near, rows, distance) else None
            here = tracks.expected[sample]
            near = settled(here, points, near, tolerance_m, metric)
            if near is not None and not self.is_exceeded(near, here, points, missed):
                near = None
        if near is not None and is_safe and is_usual and near.n_agreeing >= share:
            return near, False
        far = self._search()
        if pair and far.placement is None:
            return pair, False
        is_best = is_sharp and near is not None and far.n_agreeing <= near.n_agreeing
        is_most = near is not None and is_safe and near.n_agreeing >= share
        if near and is_best and (is_most or not far.is_doubtful):
            return near, False
        return far.placement, (
            far.placement is None and far.is_ambiguous and far.n_agreeing >= SHARE * self.possible
        )

    def _is_familiar_pair(self, near: Placement, rows: Ints, distance: Floats) -> bool:
        """Return whether two matches in the plane suffice: well known, just seen, hardly moved.

        After k nearly empty scans, the limit is divided by k + 1: the robot may move in each.
        """
        if not near.n_agreeing == len(rows) == self.points.shape[1] == 2:
            return False
        seen, missed = self.tracks.seen[rows], self.tracks.missed[rows]
        known = (seen >= FAMILIAR).all() and (missed == 0).all()
        moved_m = (1 + self.idle) * distance.max()
        return bool(known and moved_m <= NEARBY * self.scale.spacing_m)

    def _found_of_unknown_noise(self, is_ambiguous: bool) -> Placement | None:
        """Retry as if the noise were unknown: it may have grown, as when a robot starts moving.

        If several placements explain the scan, more noise would only hide that.
        """
        widest_m = self.scale.tolerance_m if is_ambiguous else np.inf
        scale = self.scale
        learnt, scale.noise_m = scale.noise_m, None
        factors: tuple[float, ...] = (*FINER, *WIDER)
        if learnt is not None:
            unit_m, known_m = COARSE * scale.spacing_m, SIGMAS * learnt
            factors = tuple(one for one in (*FINER, 1.0, *WIDER) if one * unit_m > known_m)
        placement = self._explaining(factors, widest_m)
        if placement and (learnt is None or self.is_short(self.step_m(placement))):
            return placement
        scale.wider = 1.0
        scale.noise_m = learnt
        may_be_blurred = learnt is None or scale.is_blurred
        least_m, most_m = learnt or 0.0, GROWN * learnt if learnt else np.inf
        for share in BLURRED if self.possible >= PLENTY and may_be_blurred else ():
            scale.noise_m = share * scale.spacing_m
            is_new = least_m <= scale.noise_m <= most_m and SIGMAS * scale.noise_m < widest_m
            if scale.is_blurred and is_new:
                placement = self.likely(None)
                if placement is not None:
                    return placement
        scale.noise_m = learnt
        return None

    def _explaining(self, factors: tuple[float, ...], widest_m: float) -> Placement | None:
        """Return the first placement that explains most of the scan as the tolerance grows.

        `factors`: of the tolerance while the noise is unknown; `widest_m`: it stays below. On a
        lattice, placements a period apart agree to a coarse tolerance, only one to a fine one.
        """
        scale = self.scale
        for scale.wider in factors if self.possible >= PLENTY else ():
            if scale.tolerance_m < widest_m:
                placement, _ = self._found()
                if placement is not None and placement.n_agreeing >= SHARE * self.possible:
                    return placement
        scale.wider = 1.0
        return None

    def _is_unrivalled(self, placement: Placement, rival: int) -> bool:
        """Return whether the rivals of a placement are unlikely.

        They match far less, or no more than chance does in some placement; or, from one scan to the
        next, those that match less need so much more motion that a thousand times as many
        placements are possible.
        """
        (here, there, own), least = self.crowd, CLEAR * placement.n_agreeing
        if rival <= least or self.log(rival, here, there) > 0:
            return True
        if rival >= placement.n_agreeing or self.tracks.missed.min() or self.idle:
            return False
        reach_m = self.reach_m(moved_m(placement, here), here.shape[1])
        near = search(here, there, self.scale.tolerance_m, ENOUGH, own, reach_m)
        return near is not None and near[1] <= least

    def _search(self) -> _Searched:
        """Search for the tracks in the scan, for any motion of the robot.

        If there are many, only those near the robot are used. Between rivals with similar numbers
        of matches the likelihood decides, if the noise is known.
        """
        here, there, own = self.crowd
        found = search(here, there, self.scale.tolerance_m, ENOUGH, own)
        if found is None:
            return _Searched(None, 0)
        placement, rival = found
        if not self.is_exceeded(placement, here, there, int(self.tracks.missed.min())):
            return _Searched(None, placement.n_agreeing)
        is_decidable = self.scale.noise_m is not None
        is_decidable &= min(len(here), len(there)) >= DECIDABLE
        is_clear = self._is_unrivalled(placement, rival)
        if is_clear and (not is_decidable or self.soft.misfit(placement) <= MISFIT):
            return _Searched(placement, placement.n_agreeing)
        likely = self.likely(None) if is_decidable else None
        near = self.tracks.crowd(self.points, len(self.tracks))[0]
        if likely is not None and likely.n_agreeing < SHARE * min(len(near), len(there)):
            likely = None  # the best one may not be among those suggested
        comes_near = not is_clear and rival > DISTINCT * placement.n_agreeing
        return _Searched(likely, placement.n_agreeing, True, comes_near)
