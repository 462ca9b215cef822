"""Where live tracks lie in a scan: the placement on which most matches agree, or none.

Nearest neighbours are asked first, then a search that minds no motion.  A placement is believed
where chance brings so many matches together rarely, and where no rival comes near.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import middle
from relmap.core.association.placement import Placement, trimmed_fit
from relmap.core.association.scale import SIGMAS, WIDER, Scale
from relmap.core.association.search import log_chance as chance_of
from relmap.core.association.search import search, settled
from relmap.core.association.tracks import LiveTracks

ENOUGH = 3
"""Matches that must agree: two distances agree by chance now and then, three rarely."""
PLENTY = 6
"""Matches whose agreement is never chance."""
SHARE = 0.6
"""Share of the nearest neighbours that must agree before a wider search is spared."""
FAR_SHARE = 0.3
"""Share of what could be matched that must agree where the robot moved far: in space a mirrored
scan agrees in what lies near a plane."""
SAMPLE = 32
"""Tracks that a placement is fitted to at most; more would not make it better."""
SEARCH = 30
"""Tracks that the wider search looks at, those seen longest."""
SHARP = 0.16
"""Tolerance, in spacings, up to which nearest neighbours that agree need no search for rivals."""
CLEAR = 0.6
"""Share of its matches that a rival may have."""
CROWD = 60
"""Points of a scan that it looks at, the nearest."""
LOG_CHANCE, LOG_CHANCE_NEAR = float(np.log(1e-3)), float(np.log(1e-2))
"""Log of how often a wrong placement may be taken for right, and where little has moved."""
FAMILIAR = 5
"""Sightings of a landmark that two of them, alone in a planar scan, must have to fix it."""
NEARBY = 0.2
"""How far these two may have moved, in spacings."""


@dataclass(frozen=True, eq=False)
class TrackPlacing:
    """Finds where the frame of the tracks lies in that of a scan.

    Attributes
    ----------
    scale : Scale
        Of the scans so far; it learns the spacing of each.
    idle : int
        Scans of next to nothing since the tracks were seen.
    """

    scale: Scale
    idle: int

    def placement(self, tracks: LiveTracks, points: Floats) -> Placement | None:
        """Return the placement that brings tracks onto points (n, d); None where none is sure."""
        found = self._found(tracks, points)
        return self._found_of_unknown_noise(tracks, points) if found is None else found

    def is_unique(self, placement: Placement, tracks: LiveTracks, points: Floats) -> bool:
        """Tell whether chance brings tracks onto points (n, d) so well in no placement at all."""
        chance = self._log_chance(placement.n_agreeing, tracks.expected, points)
        return bool(chance <= LOG_CHANCE)

    def _found(self, tracks: LiveTracks, points: Floats) -> Placement | None:
        """Find the placement of the tracks' frame in the scan's on which most matches agree."""
        from relmap.core.association.matching_kernels import claims, two_nearest

        n, d = points.shape
        missed = int(tracks.missed.min())
        latest = np.flatnonzero(tracks.missed == missed)
        possible = min(len(latest), n)
        if possible < 2:
            return None
        sample = latest[:: -(-len(latest) // SAMPLE)]
        crowd = points if n >= len(latest) else tracks.expected[latest]
        apart, _ = two_nearest(crowd, crowd[:: -(-len(crowd) // SAMPLE)])
        self.scale.see_spacing(middle(apart[:, 1]))
        distances, target = two_nearest(points, tracks.expected[sample])
        distance = np.where(distances[:, 0] > self.scale.spacing_m, np.inf, distances[:, 0])
        claimed = claims(target, distance, n)
        rows = sample[claimed]
        near = trimmed_fit(tracks.expected[rows], points[target[claimed]], self.scale.tolerance_m)
        is_sharp = self.scale.tolerance_m <= SHARP * self.scale.spacing_m
        if near is not None:
            if is_sharp and near.n_agreeing >= max(PLENTY + missed, SHARE * min(len(sample), n)):
                return near
            alone = near.n_agreeing == len(rows) == d == 2
            if alone and self._is_familiar_pair(tracks, rows, distance[claimed]):
                return near
            here = tracks.expected[sample]
            near = settled(here, points, near, self.scale.tolerance_m)
            if near is not None and not self._is_unlike_chance(near, here, points, missed):
                near = None
        if near is not None and is_sharp and near.n_agreeing >= SHARE * min(len(sample), n):
            return near
        far, n_far = self._search(tracks, points)
        if near is None or not is_sharp or n_far > near.n_agreeing:
            return far
        return near

    def _is_unlike_chance(
        self, placement: Placement, here: Floats, there: Floats, missed: int
    ) -> bool:
        """Tell whether a placement brings tracks (n, d) onto points (m, d) not just by chance.

        The more scans it was tried in vain with, and of next to nothing, the more must agree.
        """
        enough = ENOUGH + max(missed, min(missed + self.idle, PLENTY - ENOUGH))
        moved_m = float(np.linalg.norm(placement.apply(here) - here, axis=1).max())
        if placement.n_agreeing < enough:
            return False
        if moved_m <= self.scale.spacing_m:
            return self._log_chance(placement.n_agreeing, here, there, moved_m) <= LOG_CHANCE_NEAR
        if placement.n_agreeing < FAR_SHARE * min(len(here), len(there)):
            return False
        return self._log_chance(placement.n_agreeing, here, there) <= LOG_CHANCE

    def _log_chance(
        self, n_agreeing: int, here: Floats, there: Floats, moved_m: float | None = None
    ) -> float:
        """Return the log of how many placements bring so many tracks onto points by chance.

        They are counted in tolerances: those that move the tracks no farther, or all of them.
        """
        tolerance_m, d, placements = self.scale.tolerance_m, here.shape[1], 0.0
        if moved_m is None:
            moved_m = float(np.ptp(there, axis=0).max())
            placements = (2 * d - 3) * np.log(2 * np.pi)
        placements += d * (d + 1) / 2 * np.log(1 + 2 * moved_m / tolerance_m)
        share = min(np.log(2) * (tolerance_m / self.scale.spacing_m) ** d, 0.5)
        return chance_of(max(min(len(here), len(there)), n_agreeing), n_agreeing, share, placements)

    def _is_familiar_pair(self, tracks: LiveTracks, rows: Ints, distance: Floats) -> bool:
        """Tell whether two matches in the plane will do: well known, just seen, hardly moved."""
        known = (tracks.seen[rows] >= FAMILIAR).all() and (tracks.missed[rows] == 0).all()
        return bool(known and distance.max() <= NEARBY * self.scale.spacing_m)

    def _found_of_unknown_noise(self, tracks: LiveTracks, points: Floats) -> Placement | None:
        """Try again as if the noise were not known: it may have grown, as when a robot sets off."""
        scale, possible = self.scale, min(int(np.sum(tracks.missed == 0)), len(points))
        learnt, scale.noise_m = scale.noise_m, None
        for scale.wider in WIDER if possible >= PLENTY else ():
            if learnt is None or scale.tolerance_m > SIGMAS * learnt:
                placement = self._found(tracks, points)
                if placement is not None and placement.n_agreeing >= SHARE * min(possible, SEARCH):
                    return placement
        scale.noise_m, scale.wider = learnt, 1.0
        return None

    def _search(self, tracks: LiveTracks, points: Floats) -> tuple[Placement | None, int]:
        """Look for the tracks in the scan however the robot moved and turned.

        Of many, for those near the robot.  The placement is None where it is not sure; beside it
        stands how many matches the best one has.
        """
        away = np.linalg.norm(points, axis=1)
        within_m = np.partition(away, CROWD - 1)[CROWD - 1] if len(away) > CROWD else np.inf
        missed = int(tracks.missed.min())
        recent = tracks.missed <= missed + 1
        recent &= np.linalg.norm(tracks.expected, axis=1) <= within_m
        known = np.flatnonzero(recent)
        known = known[np.argsort(-tracks.seen[known], kind="stable")[:SEARCH]]
        here, there = tracks.expected[known], points[away <= within_m]
        found = search(here, there, self.scale.tolerance_m, ENOUGH)
        if found is None:
            return None, 0
        placement, rival = found
        if not self._is_unlike_chance(placement, here, there, missed):
            return None, placement.n_agreeing
        is_rival = rival > CLEAR * placement.n_agreeing
        # What chance brings in some placement explains nothing.
        is_rival = is_rival and self._log_chance(rival, here, there) <= 0
        return None if is_rival else placement, placement.n_agreeing
