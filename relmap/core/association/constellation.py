"""Registration that holds: matches are right where relative locations agree.

The relative locations of static landmarks do not change from one iteration to the next.  So the
placement of the previous robot frame in the present one is that on which most matches agree; it
carries every track to where it is expected, and only what is found there continues the track.  It
is forgotten afterwards: neither a pose nor a motion enters the map.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.association.base import UNIDENTIFIED, Numbered, middle
from relmap.core.association.placement import Placement, trimmed_fit
from relmap.core.association.scale import SIGMAS, WIDER, Scale, spacing_of
from relmap.core.association.search import log_chance, search, settled
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
CONTINUITY = 0.15
"""How far a moving landmark may stray in an iteration, in spacings."""
YOUNG = 3
"""A track seen less often than this may turn out to be moving."""


class Constellation(Numbered):
    """Matches scans by the relative locations of what is in them.

    Parameters
    ----------
    max_missed : int
        A track unseen for more iterations than this ends; until then it is carried along.
    """

    _tracks: LiveTracks | None
    _stray: LiveTracks | None
    _alone: list[int]
    _tracks_since: int | None
    _stray_since: int | None
    STATE = (
        "n_landmarks _tracks _stray _scale _idle _n_scans _n_open _alone _tracks_since _stray_since"
    )

    def __init__(self, max_missed: int) -> None:
        super().__init__()
        self._max_missed = max_missed
        self._tracks = self._stray = None
        self._scale = Scale()
        self._idle = 0
        self._n_scans = self._n_open = 0
        self._alone = []
        self._tracks_since = self._stray_since = None

    def match(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Match points (n, d) to the live tracks; the rest are new landmarks."""
        landmarks = np.full(len(points_robot), UNIDENTIFIED)
        continued = self._continue(points_robot, landmarks) if len(points_robot) else None
        new = self.number_new(landmarks)
        begun = LiveTracks.begun(landmarks[new], points_robot[new])
        if continued is None:
            if len(begun):
                self._alone.append(self._n_scans)
                self._n_open += 1
            self._begin_anew(begun)
        else:
            self._tracks, self._stray, self._idle = continued.joined(begun), None, 0
            self._tracks_since = None
        self._n_scans += 1
        return landmarks

    def expect(self, landmarks: NDArray[np.int64], points_robot: NDArray[np.float64]) -> None:
        """Expect landmarks (n,) at points (n, d) in the next scan, and nothing else."""
        self._tracks, self._stray = LiveTracks.begun(landmarks, points_robot), None
        self._tracks_since, self._idle = None, 0
        self._scale.spacing_m = spacing_of(points_robot)

    @property
    def tied_share(self) -> float:
        """Share of the scans after the first that were tied to those before at once."""
        return 1 - max(self._n_open - 1, 0) / max(self._n_scans - 1, 1)

    @property
    def rejected(self) -> list[int]:
        """Scans, counted from 0, that were tied to no other; one that is awaited is not yet."""
        waits = self._tracks_since if self._stray is None else None
        return [scan for scan in self._alone if scan != waits]

    def _continue(
        self, points_robot: NDArray[np.float64], landmarks: NDArray[np.int64]
    ) -> LiveTracks | None:
        """Enter the landmark of each point that continues a track; return the tracks, carried."""
        for tracks, since in (
            (self._tracks, self._tracks_since),
            (self._stray, self._stray_since),
        ):
            if tracks is None:
                continue
            placement = self._placement(tracks, points_robot)
            if placement is None:
                placement = self._placement_of_unknown_noise(tracks, points_robot)
            if placement is not None:
                carried = tracks.carried(
                    placement.apply(tracks.expected), placement.apply(tracks.latest)
                )
                rows, found, strayed = self._links(carried, points_robot)
                landmarks[found] = tracks.landmarks[rows]
                at_rest = ~strayed
                self._scale.learn(carried.expected[rows[at_rest]], points_robot[found[at_rest]])
                carried.see(rows, points_robot[found], strayed)
                if since is not None:
                    self._alone.remove(since)
                return carried.kept(carried.missed <= self._max_missed)
        return None

    def _begin_anew(self, begun: LiveTracks) -> None:
        """Wait with a scan that could not be tied to the tracks: the next one may tie to either.

        A scan of next to nothing does not tell that the tracks are over.
        """
        if self._tracks is None:
            if len(begun):
                self._tracks, self._tracks_since = begun, self._n_scans
            self._scale.spacing_m = spacing_of(begun.expected)
            return
        if len(begun) < ENOUGH:
            self._idle += 1
            return
        self._tracks.missed += 1
        self._stray, self._stray_since = begun, self._n_scans
        if self._tracks.missed.min() > self._max_missed:
            self._tracks, self._tracks_since = self._stray, self._stray_since
            self._stray, self._idle = None, 0
            self._scale.allow_noise()

    def _placement(self, tracks: LiveTracks, points: NDArray[np.float64]) -> Placement | None:
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
        self._scale.see_spacing(middle(apart[:, 1]))
        distances, target = two_nearest(points, tracks.expected[sample])
        distance = np.where(distances[:, 0] > self._scale.spacing_m, np.inf, distances[:, 0])
        claimed = claims(target, distance, n)
        rows = sample[claimed]
        near = trimmed_fit(tracks.expected[rows], points[target[claimed]], self._scale.tolerance_m)
        is_sharp = self._scale.tolerance_m <= SHARP * self._scale.spacing_m
        if near is not None:
            if is_sharp and near.n_agreeing >= max(PLENTY + missed, SHARE * min(len(sample), n)):
                return near
            alone = near.n_agreeing == len(rows) == d == 2
            if alone and self._is_familiar_pair(tracks, rows, distance[claimed]):
                return near
            here = tracks.expected[sample]
            near = settled(here, points, near, self._scale.tolerance_m)
            if near is not None and not self._is_unlike_chance(near, here, points, missed):
                near = None
        if near is not None and is_sharp and near.n_agreeing >= SHARE * min(len(sample), n):
            return near
        far, n_far = self._search(tracks, points)
        if near is None or not is_sharp or n_far > near.n_agreeing:
            return far
        return near

    def _is_unlike_chance(
        self,
        placement: Placement,
        here: NDArray[np.float64],
        there: NDArray[np.float64],
        missed: int,
    ) -> bool:
        """Tell whether a placement brings tracks (n, d) onto points (m, d) not just by chance.

        The more scans it was tried in vain with, and of next to nothing, the more must agree.
        """
        enough = ENOUGH + max(missed, min(missed + self._idle, PLENTY - ENOUGH))
        moved_m = float(np.linalg.norm(placement.apply(here) - here, axis=1).max())
        if placement.n_agreeing < enough:
            return False
        if moved_m <= self._scale.spacing_m:
            return self._log_chance(placement.n_agreeing, here, there, moved_m) <= LOG_CHANCE_NEAR
        if placement.n_agreeing < FAR_SHARE * min(len(here), len(there)):
            return False
        return self._log_chance(placement.n_agreeing, here, there) <= LOG_CHANCE

    def _log_chance(
        self,
        n_agreeing: int,
        here: NDArray[np.float64],
        there: NDArray[np.float64],
        moved_m: float | None = None,
    ) -> float:
        """Return the log of how many placements bring so many tracks onto points by chance.

        They are counted in tolerances: those that move the tracks no farther, or all of them.
        """
        tolerance_m, d, placements = self._scale.tolerance_m, here.shape[1], 0.0
        if moved_m is None:
            moved_m = float(np.ptp(there, axis=0).max())
            placements = (2 * d - 3) * np.log(2 * np.pi)
        placements += d * (d + 1) / 2 * np.log(1 + 2 * moved_m / tolerance_m)
        share = min(np.log(2) * (tolerance_m / self._scale.spacing_m) ** d, 0.5)
        return log_chance(
            max(min(len(here), len(there)), n_agreeing), n_agreeing, share, placements
        )

    def _is_familiar_pair(
        self, tracks: LiveTracks, rows: NDArray[np.int64], distance: NDArray[np.float64]
    ) -> bool:
        """Tell whether two matches in the plane will do: well known, just seen, hardly moved."""
        known = (tracks.seen[rows] >= FAMILIAR).all() and (tracks.missed[rows] == 0).all()
        return bool(known and distance.max() <= NEARBY * self._scale.spacing_m)

    def _placement_of_unknown_noise(
        self, tracks: LiveTracks, points: NDArray[np.float64]
    ) -> Placement | None:
        """Try again as if the noise were not known: it may have grown, as when a robot sets off."""
        scale, possible = self._scale, min(int(np.sum(tracks.missed == 0)), len(points))
        learnt, scale.noise_m = scale.noise_m, None
        for scale.wider in WIDER if possible >= PLENTY else ():
            if learnt is None or scale.tolerance_m > SIGMAS * learnt:
                placement = self._placement(tracks, points)
                if placement is not None and placement.n_agreeing >= SHARE * min(possible, SEARCH):
                    return placement
        scale.noise_m, scale.wider = learnt, 1.0
        return None

    def _search(
        self, tracks: LiveTracks, points: NDArray[np.float64]
    ) -> tuple[Placement | None, int]:
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
        found = search(here, there, self._scale.tolerance_m, ENOUGH)
        if found is None or not self._is_unlike_chance(found[0], here, there, missed):
            return None, 0
        placement, rival = found
        is_rival = rival > CLEAR * placement.n_agreeing
        # What chance brings in some placement explains nothing.
        is_rival = is_rival and self._log_chance(rival, here, there) <= 0
        return None if is_rival else placement, placement.n_agreeing

    def _links(
        self, carried: LiveTracks, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Link tracks, carried along, to what is found where they are expected.

        Returns
        -------
        rows, found : (k,) int64
            Tracks and the points that continue them.
        strayed : (k,) bool
            Where the track moves against the others: it is followed by continuity.
        """
        from relmap.core.association.matching_kernels import claims, nearest_within

        distance, target = nearest_within(points, carried.expected, self._scale.gate_m)
        linked = claims(target, distance, len(points))
        taken = np.zeros(len(points) + 1, dtype=bool)
        taken[target[linked]] = True
        free = np.flatnonzero(~linked & (carried.missed == 0))
        followed, found = self._follow(carried, free, points, taken)
        rows = np.concatenate([np.flatnonzero(linked), followed])
        strayed = np.arange(len(rows)) >= linked.sum()
        return rows, np.concatenate([target[linked], found]), strayed

    def _follow(
        self,
        carried: LiveTracks,
        free: NDArray[np.int64],
        points: NDArray[np.float64],
        taken: NDArray[np.bool_],
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Follow tracks that are not where they would be at rest, from where they were last.

        One that was seen moving, or is too young to tell, may go far; one that was at rest so far
        only as far as it could drift unnoticed: a jump is another landmark's.
        """
        if not len(free):
            return free, free
        from relmap.core.association.matching_kernels import claims, nearest_within

        may_move = (carried.restless[free] > 0) | (carried.seen[free] < YOUNG)
        reach = np.where(
            may_move,
            max(CONTINUITY * self._scale.spacing_m, self._scale.gate_m),
            self._scale.gate_m,
        )
        distance, target = nearest_within(points, carried.latest[free], float(reach.max()))
        near = np.where((distance <= reach) & ~taken[target], distance, np.inf)
        followed = claims(target, near, len(points))
        return free[followed], target[followed]
