"""Whether another explanation of a scan comes near the one that was found: who tells them apart?

Doors along a corridor repeat, and so do the panels of a wall: corners may be matched with those
beside them, and the scan agrees nearly as well.
"""

from __future__ import annotations

import numpy as np

from relmap.planes.matching import Match
from relmap.planes.observation import PlaneObservation
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
"""Share of the agreement on a motion that makes another one its rival."""
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
        A rival differs by no more than this from going on as before or from standing still, or by
        no more than the motion found.
    """
    from relmap.planes.matching_kernels import guesses

    motion, match = found
    own_m = surprise_m(motion, usual)
    credible_m = max(credible_m, own_m)
    if own_m + credible_m < APART_M:
        return False
    own, reach = np.array([[motion.yaw, *motion.t]]), (REACH_M, TURN_RAD)
    enough = SHARE * match.score
    motions, scores = guesses(
        *arrays_of(tracks, seen), ROUGHLY, reach, own, (APART_M, APART_RAD), GUESSES
    )
    others = [PlanarMotion(float(row[0]), row[1:]) for row in motions[scores > enough]]
    for other in (usual, STILL, *others):
        if apart(other, motion) and surprise_m(other, usual) < credible_m + APART_M:
            rival, its = settled(tracks, seen, other)
            credible = apart(rival, motion) and surprise_m(rival, usual) <= credible_m
            if credible and its.score > enough:
                return True
    return False


def apart(one: PlanarMotion, other: PlanarMotion) -> bool:
    """Tell whether two motions differ by more than noise."""
    turn = np.abs((one.yaw - other.yaw + np.pi) % (2 * np.pi) - np.pi)
    return bool(np.hypot(*(one.t - other.t)) >= APART_M or turn >= APART_RAD)
