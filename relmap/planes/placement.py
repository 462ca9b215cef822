"""Where the frame of the tracks lies in that of a scan: the motion on which most walls agree.

As with points it is a rough one, good for association only, and then forgotten.  It is not
looked for by the largest consistent set, as with points (`relmap.core.association.placement`): that
of the corners alone, which hold it, broke csail into 91 submaps, not 58, and fhw into 42, not 35.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.planes.observation import PlaneObservation
from relmap.planes.tracks import PlaneTracks

ROUGHLY = 3.0
"""Tolerances of a guess, in units of those of the final match."""
REACH_M = 3.0
TURN_RAD = np.deg2rad(45.0)
"""How far the wider search goes between two scans."""
HELD = 1e-2
"""Weight of going on as before, where nothing that is seen tells: a wall's is 1."""
ROUNDS = 3
HALTED = 0.05
"""How much more must agree on a halt than on going on: along a single wall both agree alike."""
GUESSES = 3
"""Motions of the wider search that are looked at closely."""
CONTENT = 0.8
"""Share of what could agree that must, before a wider search is spared."""
DOUBT = 2.0
"""Walls and corners more that must agree on a sudden motion than on going on as before: single
walls look alike."""
SUDDEN_M = 0.75
LEVER_M = 3.0
"""A turn is as sudden as the way that it takes a wall at this distance."""
MANY = 7
"""Walls that must agree on a motion farther than a robot goes: fewer look alike elsewhere."""
LEAST_M = 0.02
"""Noise of a corner that its weight is reckoned with at least."""


@dataclass(frozen=True, eq=False)
class PlanarMotion:
    """A motion in the plane from one robot frame into another: ``R(yaw) @ p + t``."""

    yaw: float
    t: NDArray[np.float64]


STILL = PlanarMotion(0.0, np.zeros(2))


@dataclass(frozen=True, eq=False)
class Match:
    """Walls of a scan and the tracks that they continue, one to one.

    Attributes
    ----------
    tracks, walls : (k,) int64
    score : float
        How well they agree: each wall counts for 1 at most, each corner too.
    """

    tracks: NDArray[np.int64]
    walls: NDArray[np.int64]
    score: float


def place(
    tracks: PlaneTracks,
    seen: PlaneObservation,
    before: PlanarMotion,
    farthest_m: float = np.inf,
) -> tuple[PlanarMotion, Match] | None:
    """Find the motion of the tracks' frame into the scan's, and the association by it.

    Tried are to go on as before, to stand still, and where neither will do, every pair of a track's
    corner and a corner of the scan: with the direction of its wall one corner fixes a motion.

    Parameters
    ----------
    tracks : PlaneTracks
    seen : PlaneObservation
    before : PlanarMotion
        The motion between the two scans before.  Where walls seen leave a direction open, as along
        a single partial one, the robot is taken to go on like that (motion model).
    farthest_m : float
        A motion longer than this is a jump, which many walls must agree on.

    Returns
    -------
    (motion, match) or None
        None where no wall agrees, or too few on a jump.
    """
    from relmap.planes.matching_kernels import guesses

    best, still = (settled(tracks, seen, guess) for guess in (before, STILL))
    if still[1].score > best[1].score + HALTED:
        best = still
    recent = tracks.missed == tracks.missed.min(initial=0)
    possible = min(worth(tracks, seen, recent))
    if best[1].score < CONTENT * possible:
        motions, scores = guesses(tracks.arrays, seen.arrays, ROUGHLY, REACH_M, TURN_RAD, GUESSES)
        for motion in motions[scores > best[1].score]:
            found = settled(tracks, seen, PlanarMotion(float(motion[0]), motion[1:]))
            doubt = _doubt(found[0], before)
            if not _jumps(*found, farthest_m) and found[1].score > best[1].score + doubt:
                best = found
    return best if len(best[1].tracks) and not _jumps(*best, farthest_m) else None


def _jumps(motion: PlanarMotion, match: Match, farthest_m: float) -> bool:
    return len(match.tracks) < MANY and float(np.hypot(*motion.t)) > farthest_m


def _doubt(motion: PlanarMotion, before: PlanarMotion) -> float:
    """Return how many walls and corners more must agree on a motion, the more sudden it is."""
    jumps = [
        np.hypot(*(motion.t - usual.t)) + LEVER_M * abs(motion.yaw - usual.yaw)
        for usual in (before, STILL)
    ]
    return float(0.5 + DOUBT * min(1.0, min(jumps) / SUDDEN_M))


def worth(
    tracks: PlaneTracks, seen: PlaneObservation, recent: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return the score if all tracks seen last were seen again, and if all walls were known."""
    return (
        float(recent.sum() + np.isfinite(tracks.corner_at[recent, :, 0]).sum()),
        float(len(seen) + seen.static.sum()),
    )


def settled(
    tracks: PlaneTracks, seen: PlaneObservation, guess: PlanarMotion
) -> tuple[PlanarMotion, Match]:
    """Fit a guess to what agrees with it, and see again what agrees."""
    from relmap.planes import matching_kernels

    start = np.array([guess.yaw, *guess.t])
    motion, track_of, score = matching_kernels.settled(
        tracks.arrays, seen.arrays, start, ROUGHLY, ROUNDS, HELD, LEAST_M
    )
    walls = np.flatnonzero(track_of >= 0)
    return PlanarMotion(float(motion[0]), motion[1:]), Match(track_of[walls], walls, score)
