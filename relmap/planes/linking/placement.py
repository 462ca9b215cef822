"""The placement of the tracks' frame in that of a scan: the motion on which most walls agree.

As with points it is approximate, used for association only, and then discarded. It is not found by
the largest consistent set, as with points (`relmap.core.association.placement`): using the corners
alone split csail into 91 submaps instead of 58, and fhw into 42 instead of 35.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.tracks import PlaneTracks
from relmap.planes.scans.observation import PlaneObservation

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
MANY = 7
"""Walls that must agree on a motion longer than usual."""
STILL = np.zeros(3)
"""No motion. A motion (3,) is yaw, x, y from one robot frame into another: ``R(yaw) @ p + t``."""


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

    Candidates are constant motion, no motion, and if neither suffices, every pair of a track's
    corner and a corner of the scan: a corner and the direction of its wall determine a motion.

    `before`: the previous motion. Where the observed walls do not determine a direction, as with a
    single partial wall, constant motion is assumed (motion model). `farthest_m`: a longer motion is
    a jump, which requires more agreeing walls. Returns (motion, match): None if no wall agrees, or
    too few for a jump.
    """
    from relmap.planes.linking.matching_kernels import guesses

    motions, matches = settled(tracks, seen, [before, STILL])
    best, still = zip(motions, matches, strict=True)
    if still[1].score > best[1].score + HALTED:
        best = still
    recent = tracks.missed == tracks.missed.min(initial=0)
    possible = min(worth(tracks, seen, recent))
    if best[1].score < CONTENT * possible:
        motions, scores = guesses(tracks.arrays, seen.arrays)
        likely = motions[scores > best[1].score]
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
    found = matching_kernels.settled(tracks.arrays, seen.arrays, starts, rounds)
    motions, track_of, scores = found
    matches = list[Match]()
    for own, score in zip(track_of, scores.tolist(), strict=True):
        walls = np.flatnonzero(own >= 0)
        matches.append(Match(own[walls], walls, score))
    return motions, matches
