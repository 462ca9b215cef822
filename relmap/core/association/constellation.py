"""Registration by consistent relative locations.

The relative locations of static landmarks do not change from one iteration to the next.  The
placement of the previous robot frame in the current one is therefore the one with the most
consistent matches. It predicts every track, and only observations near a prediction continue a
track. The placement is discarded afterwards: neither a pose nor a motion enters the map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.base import UNIDENTIFIED, Numbered, middle
from relmap.core.association.chance import ENOUGH
from relmap.core.association.guiding import OdometryGuide
from relmap.core.association.likelihood import CLEAR
from relmap.core.association.metric import RayNoise, farthest, scaled
from relmap.core.association.placement import Placement
from relmap.core.association.registering import BLIND, TrackPlacing
from relmap.core.association.scale import FEW, Scale, spacing_of
from relmap.core.association.soft import likely_links
from relmap.core.association.tracks import LiveTracks

CONTINUITY = 0.15
"""Largest displacement of a moving landmark in one iteration, in spacings."""
MEMORY = 8
"""Approximate number of observations averaged in the prediction of a track."""
CAREFUL = 5
"""Iterations without motion after which a track seen moving counts as static again."""
YOUNG = 3
"""A track with fewer observations than this may turn out to be moving."""

NEAR = 0.3
"""Largest distance of a landmark from its prediction by odometry, in spacings."""
TINY_M = 1e-6
"""Minimum noise of matches when weighed against odometry."""


class _Placed(NamedTuple):
    """Tracks placed in a scan.

    `since`: the scan in which they began, if that waits for another to match it; `is_unique`:
    whether the matches exceed chance in any placement.
    """

    tracks: LiveTracks
    since: int | None
    placement: Placement
    is_unique: bool

    def is_far_better(self, other: _Placed) -> bool:
        """Return whether the matches are sure, and far more than those of another placement."""
        n_other = other.placement.n_agreeing
        return self.is_unique and n_other <= CLEAR * self.placement.n_agreeing


class Constellation(Numbered):
    """Matches scans by the relative locations of their landmarks.

    `max_missed`: a track missed for more iterations than this ends; until then it is predicted from
    scan to scan.
    """

    _tracks: LiveTracks | None
    _stray: LiveTracks | None
    _alone: list[int]
    _tracks_since: int | None
    _stray_since: int | None
    STATE = (
        "n_landmarks _tracks _stray _scale _idle _n_scans _n_empty _n_open _n_unique _alone "
        "_tracks_since _stray_since _guide"
    )

    def __init__(self, max_missed: int) -> None:
        super().__init__()
        self._max_missed = max_missed
        self._tracks = self._stray = None
        self._scale = Scale()
        self._idle = 0
        self._n_scans = self._n_empty = self._n_open = self._n_unique = 0
        self._alone = []
        self._tracks_since = self._stray_since = None
        self._guide = OdometryGuide()

    def match(self, points_robot: Floats, ids: Ints | None) -> Ints:
        """Match points (n, d) to the live tracks; unmatched points are new landmarks."""
        landmarks = None
        if len(points_robot) or self._guide.knows:
            landmarks = self._continued(points_robot)
        if landmarks is None:
            landmarks = np.full(len(points_robot), UNIDENTIFIED)
            self.number_new(landmarks)
            if len(landmarks):
                self._alone.append(self._n_scans)
                self._n_open += 1
            self._begin_anew(LiveTracks.begun(landmarks.copy(), points_robot))
        self._n_scans += 1
        self._n_empty += not len(points_robot)
        return landmarks

    def begin_log(self) -> None:
        """Note that a log begins: its first scan may be taken anywhere."""
        self._scale.step_m = 0.0

    def inform(self, motion: Floats | None, covariances: Floats | None) -> None:
        """Use the odometry (4, 4) into the next scan and its covariances (n, d, d), if known."""
        self._guide.note(motion)
        self._scale.rays.given = covariances

    @property
    def estimated(self) -> RayNoise:
        """Noise of observations that come without covariances."""
        return self._scale.rays

    def expect(self, landmarks: Ints, points_robot: Floats) -> None:
        """Expect landmarks (n,) at points (n, d) in the next scan, and no others."""
        self._tracks, self._stray = LiveTracks.begun(landmarks, points_robot), None
        self._tracks_since, self._idle = None, 0
        self._guide.forget()
        self._guide.note(None)  # They are where the next scan is taken.
        self._scale.spacing_m = spacing_of(points_robot)

    @property
    def tied_share(self) -> float | None:
        """Fraction of the scans after the first that were matched to the tracks at once.

        Empty scans do not count; None if there is no second scan.
        """
        return 1 - max(self._n_open - 1, 0) / self._n_later if self._n_later else None

    @property
    def unique_share(self) -> float | None:
        """Fraction of the scans after the first whose matches exceed chance in any placement.

        Empty scans do not count; None if there is no second scan.
        """
        return self._n_unique / self._n_later if self._n_later else None

    @property
    def _n_later(self) -> int:
        """Number of scans after the first that are not empty."""
        return max(self._n_scans - self._n_empty - 1, 0)

    @property
    def is_blurred(self) -> bool:
        """Whether the noise makes many single matches ambiguous."""
        return self._scale.is_blurred

    @property
    def rejected(self) -> list[int]:
        """Scans, counted from 0, that matched no other; a deferred scan is not included."""
        waits = self._tracks_since if self._stray is None else None
        return [scan for scan in self._alone if scan != waits]

    def _continued(self, points_robot: Floats) -> Ints | None:
        """Continue the tracks; return the landmarks of the points (n,), None if nothing matches.

        If matches with the tracks may be due to chance, the deferred scan is continued instead if
        it matches surely and far better: that breaks the run.
        """
        metric, spacing_m = self._scale.rays.metric(points_robot), self._scale.spacing_m
        found = self._placed(self._tracks, self._tracks_since, points_robot, metric)
        if found is None or not (found.is_unique or self._guide.knows):
            other = self._placed(self._stray, self._stray_since, points_robot, metric)
            if found is None or (other is not None and other.is_far_better(found)):
                found = other
        if found is None:
            return None
        self._n_unique += found.is_unique
        if found.since is not None:
            self._alone.remove(found.since)
        landmarks = self._followed(found.tracks, found.placement, points_robot, metric)
        if len(points_robot) < 2:  # what was guessed is not learnt
            self._scale.spacing_m = spacing_m
        return landmarks

    def _placed(
        self, tracks: LiveTracks | None, since: int | None, points: Floats, metric: Floats | None
    ) -> _Placed | None:
        """Return tracks that began in a scan that waits `since` then, placed in a scan (n, d)."""
        if tracks is None:
            return None
        is_last, is_unique = tracks is self._tracks, False
        idle = self._idle if is_last else self._n_scans - 1 - (since or 0)
        placing = TrackPlacing(self._scale, idle, metric, tracks, points)
        placement = placing.placement() if len(points) and len(tracks) else None
        if placement is not None:
            is_unique = placing.is_unique(placement)
        guide, expected = self._guide, tracks.expected
        if placement is not None and is_unique and is_last:
            guide.learn(placement, expected, self._noise_m)
        elif (is_last and guide.knows) and (
            placement is None or guide.contradicts(placement, expected, self._noise_m)
        ):
            if math.isinf(self._scale.spacing_m) and len(points):
                self._scale.spacing_m = _guessed_spacing(points)
            most_m = NEAR * self._scale.spacing_m
            placement = guide.placement(expected, points, self._noise_m, most_m)
        return None if placement is None else _Placed(tracks, since, placement, is_unique)

    def _followed(
        self, tracks: LiveTracks, placement: Placement, points: Floats, metric: Floats | None
    ) -> Ints:
        """Continue the tracks, placed in a scan; return the landmarks of its points (n,)."""
        import relmap.core.association.tracking_kernels as kernels

        pose, limits = (placement.R, placement.t), (MEMORY, CAREFUL, self._max_missed)
        if self._scale.is_blurred:
            columns = kernels.carried(tracks.columns, *pose)
            expected, variance = columns[1], self._scale.variances(tracks.seen)
            rows, found = likely_links(expected, variance, tracks.seen, points, metric)
            n_static = len(rows)
            now = kernels.followed(
                points, columns, (rows, found, n_static), self.n_landmarks, limits
            )
        else:
            # A track seen moving, or too short to classify, may move far from its last observation;
            # a static one only as far as it could drift unnoticed: a jump is another landmark.
            gate_m = self._scale.gate_m
            far_m = max(CONTINUITY * self._scale.spacing_m, gate_m)
            reaches = far_m, gate_m, farthest(gate_m, metric)
            expected, (rows, found, n_static), now = kernels.tracked(
                points, tracks.columns, pose, reaches, metric, self.n_landmarks, (YOUNG, *limits)
            )
        landmarks, of, places, counts, square = now
        self._tracks = LiveTracks(of, *places, *counts)
        rays, known, seen = self._scale.rays, rows[:n_static], found[:n_static]
        if n_static > FEW and rays.is_due():
            rays.learn(expected[known], points[seen], tracks.seen[known])
        if metric is not None and n_static:
            off = scaled(metric[seen], expected[known] - points[seen])
            square = middle(np.sum(off**2, axis=1))
        self._scale.learn(square, n_static, points.shape[1])
        self.n_landmarks += len(points) - len(rows)
        self._stray, self._tracks_since, self._idle = None, None, 0
        self._guide.forget()
        return landmarks

    @property
    def _noise_m(self) -> float:
        """Standard deviation of a coordinate's difference between two scans."""
        return max(self._scale.noise_m or self._scale.gate_m, TINY_M)

    def _begin_anew(self, begun: LiveTracks) -> None:
        """Defer a scan that could not be matched to the tracks: the next one may match either.

        A nearly empty scan does not end the tracks; another place after many of them does.
        """
        if self._idle > BLIND and len(begun) >= ENOUGH:
            self._tracks, self._stray, self._idle = None, None, 0
        if self._tracks is None or not len(self._tracks):
            if len(begun):
                self._tracks, self._tracks_since = begun, self._n_scans
                self._guide.forget()
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
            self._guide.forget()
            self._scale.allow_noise()


def _guessed_spacing(points: Floats) -> float:
    """Return the spacing of points (n, d), robot frame, metres; of a single one its distance."""
    apart_m = spacing_of(points)
    if math.isfinite(apart_m):
        return apart_m
    return float(np.linalg.norm(points, axis=1).max()) or apart_m
