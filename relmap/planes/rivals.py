"""Whether another explanation of a scan comes near the one that was found.

Doors along a corridor repeat, and so do the panels of a wall: corners may be matched with those
beside them, and the scan agrees nearly as well.
"""

from __future__ import annotations

import numpy as np

from relmap.planes.matching import Match
from relmap.planes.observation import SHORTEST_M, PlaneObservation
from relmap.planes.placement import (
    APART_M,
    APART_RAD,
    GUESSES,
    ROUGHLY,
    STILL,
    TURN_RAD,
    PlanarMotion,
    arrays_of,
    settled,
    surprise_m,
)
from relmap.planes.tracks import PlaneTracks

SHARE = 0.8
"""Share of the agreement on a motion that makes another one its rival, if it is as credible."""
SAME = 0.7
FAR_M = 0.5
"""A rival matches fewer than this share of its walls alike, or is so far off."""
REACH_M = 4.0
"""So far goes a rival at most."""


def rivalled(
    tracks: PlaneTracks,
    seen: PlaneObservation,
    usual: PlanarMotion,
    found: tuple[PlanarMotion, Match],
    credible_m: float,
) -> bool:
    """Tell whether a scan agrees nearly as well on another motion, apart by more than noise.

    Parameters
    ----------
    tracks : PlaneTracks
    seen : PlaneObservation
    usual : PlanarMotion
        The motion of the scans before.
    found : (motion, match)
        The motion of the tracks' frame into the scan's, and who is who by it.
    credible_m : float
        A rival differs by no more than this from going on as before or from standing still.
    """
    from relmap.planes.matching_kernels import guesses

    motion, match = found
    own_m = surprise_m(motion, usual)
    if own_m + credible_m < APART_M:
        return False
    own, reach = np.array([[motion.yaw, *motion.t]]), (REACH_M, TURN_RAD)
    least = SHARE * match.score
    motions, scores = guesses(
        *arrays_of(tracks, seen), ROUGHLY, reach, own, (APART_M, APART_RAD), GUESSES
    )
    others = [PlanarMotion(float(row[0]), row[1:]) for row in motions[scores > least]]
    for other in (usual, STILL, *others):
        if apart(other, motion) and surprise_m(other, usual) < credible_m + APART_M:
            rival, its = settled(tracks, seen, other)
            more = (surprise_m(rival, usual) - own_m) / max(credible_m, SHORTEST_M)
            enough = match.score * (SHARE + (1 - SHARE) * max(more, 0.0))
            if more <= 1 and its.score > enough and _differ(rival, its, *found):
                return True
    return False


def _differ(rival: PlanarMotion, its: Match, motion: PlanarMotion, match: Match) -> bool:
    """Tell whether a rival says otherwise who is who, or how far the robot went."""
    track_of = dict(zip(match.walls.tolist(), match.tracks.tolist(), strict=True))
    pairs = zip(its.walls.tolist(), its.tracks.tolist(), strict=True)
    same = sum(track_of.get(wall) == track for wall, track in pairs)
    far = np.hypot(*(rival.t - motion.t)) > FAR_M
    return apart(rival, motion) and bool(far or same <= SAME * len(its.tracks))


def apart(one: PlanarMotion, other: PlanarMotion) -> bool:
    """Tell whether two motions differ by more than noise."""
    turn = np.abs((one.yaw - other.yaw + np.pi) % (2 * np.pi) - np.pi)
    return bool(np.hypot(*(one.t - other.t)) >= APART_M or turn >= APART_RAD)
