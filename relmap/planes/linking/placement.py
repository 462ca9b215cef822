"""Tracks of walls, and their placement in a scan: the motion on which most walls agree.

As with points it is approximate, used for association only, and then discarded. It is not found by
the largest consistent set, as with points (`relmap.core.association.placement`): using the corners
alone split csail into 91 submaps instead of 58, and fhw into 42 instead of 35.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.tracks import Tracks
from relmap.planes.motions import wrapped
from relmap.planes.scans.observation import PlaneObservation

MEMORY = 8
"""Approximate number of observations averaged in the prediction of a wall or corner."""
NO_CORNER = -1
"""Marks a side without a corner so far."""
ROUNDS = 3
HALTED = 0.05
"""Additional score required for standing still over constant motion: along a single wall both agree
equally."""
CONTENT = 0.8
"""Fraction of the maximum score above which the wider search is skipped."""
DOUBT = 2.0
"""Additional walls and corners that must agree on a sudden motion compared with constant motion:
single walls are ambiguous."""
SUDDEN_M = 0.75
LEVER_M = 3.0
"""Distance at which a rotation counts as the equivalent translation."""
GUESSES, REACH_RAD = 3, np.deg2rad(45.0)
"""Number of motions of the wider search that are evaluated in full, and largest rotation."""
MANY = 7
"""Walls that must agree on a motion longer than usual."""
STILL = np.zeros(3)
"""No motion. A motion (3,) is yaw, x, y from one robot frame into another: ``R(yaw) @ p + t``."""


@dataclass(eq=False)
class PlaneTracks(Tracks):
    """Tracked walls in the robot frame of one iteration, predicted if missed; n walls.

    `plane` (n,): number of the wall; `angle` (n,), radians, and `offset` (n,), metres: direction of
    the normal, and ``normal @ p`` of every point p, averages of the last observations; `ends`
    (n, 2, 2), metres, and `sd` (n,), metres: ends, and standard deviation of the offset, as last
    observed; `corner` (n, 2): number of the corner on either side, or `NO_CORNER`; `corner_at`
    (n, 2, 2), metres: its position, the average of the last observations, NaN if there is none;
    `corner_seen` (n, 2): how often it was seen; `missed` (n,): iterations since the wall was last
    observed; `seen` (n,): how often it was seen; `loose` (n,): whether it was on a small
    free-standing object when it was first seen.
    """

    plane: Ints
    angle: Floats
    offset: Floats
    ends: Floats
    sd: Floats
    corner: Ints
    corner_at: Floats
    corner_seen: Ints
    missed: Ints
    seen: Ints
    loose: Bools

    @classmethod
    def begun(cls, plane: Ints, seen: PlaneObservation) -> PlaneTracks:
        """Return tracks of walls seen for the first time, without their corners yet."""
        n, angle = len(seen), np.arctan2(seen.normal[:, 1], seen.normal[:, 0])
        line = angle, seen.offset.copy(), seen.ends.copy(), seen.sd.copy()
        corner, corner_at = np.full((n, 2), NO_CORNER), np.full((n, 2, 2), np.nan)
        corner_seen, missed = np.zeros((n, 2), dtype=np.int64), np.zeros(n, dtype=np.int64)
        return cls(plane, *line, corner, corner_at, corner_seen, missed, missed + 1, seen.loose)

    @classmethod
    def of_scan(cls, plane: Ints, seen: PlaneObservation) -> PlaneTracks:
        """Return the walls of one scan, with the places of their corners, as tracks."""
        tracks = cls.begun(plane, seen)
        tracks.corner_at = np.where(seen.static[..., None], seen.ends, np.nan)
        return tracks

    @property
    def normal(self) -> Floats:
        """Unit vectors (n, 2) towards where the robot was."""
        normal = np.empty((len(self.angle), 2))
        np.cos(self.angle, out=normal[:, 0])
        np.sin(self.angle, out=normal[:, 1])
        return normal

    @property
    def arrays(self) -> Any:
        """The tracks in the form used by the compiled matching."""
        return self.angle, self.offset, self.ends, self.sd, self.corner_at

    def carried(self, motion: Floats) -> PlaneTracks:
        """Return the tracks in another frame, given the motion (3,) to it: yaw, x, y."""
        from relmap.planes.linking.matching_kernels import carried

        angle, offset, ends, sd, corner_at = carried(self.arrays, motion)
        corner, corner_seen = self.corner.copy(), self.corner_seen.copy()
        moved = angle, offset, ends, sd, corner, corner_at, corner_seen
        return PlaneTracks(self.plane, *moved, self.missed.copy(), self.seen.copy(), self.loose)

    def see(self, rows: Ints, seen: PlaneObservation, at: Ints) -> None:
        """Record that walls `at` (k,) of a scan continue tracks `rows`; others were missed."""
        self.missed += 1
        self.missed[rows] = 0
        self.seen[rows] += 1
        share = 1 / np.minimum(self.seen[rows], MEMORY)
        angle = np.arctan2(seen.normal[at, 1], seen.normal[at, 0])
        ends = seen.ends[at]
        middle = (ends[:, 0] + ends[:, 1]) / 2
        across = (self.normal[rows] * middle).sum(axis=1) - self.offset[rows]
        self.angle[rows] += share * wrapped(angle - self.angle[rows])
        # The average is taken at the observed part of the wall, not where its line passes the
        # robot.
        now = (self.normal[rows] * middle).sum(axis=1)
        self.offset[rows] = now - (1 - share) * across
        self.ends[rows] = ends
        self.sd[rows] = seen.sd[at]


@dataclass(frozen=True, eq=False)
class Match:
    """Walls of a scan and the tracks that they continue, one to one.

    `tracks`, `walls` (k,); `score`: score of the match: at most 1 for each wall and each corner.
    """

    tracks: Ints
    walls: Ints
    score: float


def place(
    tracks: PlaneTracks, seen: PlaneObservation, before: Floats, farthest_m: float = np.inf
) -> tuple[Floats, Match] | None:
    """Find the motion from the tracks' frame to the scan's, and the resulting association.

    Candidates are constant motion, no motion, and if neither suffices, those that corners and
    crossing walls imply.

    `before`: the previous motion. Where the observed walls do not determine a direction, as with a
    single partial wall, constant motion is assumed (motion model). `farthest_m`: a longer motion is
    a jump, which requires more agreeing walls. Returns (motion, match): None if no wall agrees, or
    too few for a jump.
    """
    from relmap.planes.linking.guess_kernels import implied

    motions, matches = settled(tracks, seen, [before, STILL])
    best, still = zip(motions, matches, strict=True)
    if still[1].score > best[1].score + HALTED:
        best = still
    recent = tracks.missed == tracks.missed.min(initial=0)
    possible = min(worth(tracks, seen, recent))
    if best[1].score < CONTENT * possible:
        motions = implied(tracks.arrays, seen.arrays, REACH_RAD)
        scores = [match.score for match in settled(tracks, seen, motions, 0)[1]]
        likely = motions[np.argsort(np.negative(scores), kind="stable")[:GUESSES]]
        for found in zip(*settled(tracks, seen, likely), strict=True):
            jumps = [
                np.hypot(*(found[0] - usual)[1:]) + LEVER_M * abs(found[0][0] - usual[0])
                for usual in (before, STILL)
            ]
            doubt = 0.5 + DOUBT * min(1.0, min(jumps) / SUDDEN_M)
            if not _jumps(*found, farthest_m) and found[1].score > best[1].score + doubt:
                best = found
    return best if len(best[1].tracks) and not _jumps(*best, farthest_m) else None


def _jumps(motion: Floats, match: Match, farthest_m: float) -> bool:
    return len(match.tracks) < MANY and float(np.hypot(*motion[1:])) > farthest_m


def worth(tracks: PlaneTracks, seen: PlaneObservation, recent: Bools) -> tuple[float, float]:
    """Return the maximum scores: if all recent tracks were seen, and if all walls were known."""
    return (
        float(recent.sum() + np.isfinite(tracks.corner_at[recent, :, 0]).sum()),
        float(len(seen) + seen.static.sum()),
    )


def settled(
    tracks: PlaneTracks,
    seen: PlaneObservation,
    guesses: Sequence[Floats] | Floats,
    rounds: int = ROUNDS,
) -> tuple[Floats, list[Match]]:
    """Fit each of some motions (3,) to the walls that match, and match again; (k, 3)."""
    from relmap.planes.linking import matching_kernels

    starts = np.array(guesses).reshape(-1, 3)
    motions, track_of, scores = matching_kernels.settled(tracks.arrays, seen.arrays, starts, rounds)
    matches = list[Match]()
    for own, known, score in zip(track_of, track_of >= 0, scores.tolist(), strict=True):
        walls = known.nonzero()[0]
        matches.append(Match(own[walls], walls, score))
    return motions, matches
