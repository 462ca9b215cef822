"""Acceptance of links between scans; if no link is accepted, a submap ends.

An unmeasured motion would be arbitrary, and one supported by few walls may be wrong, displacing the
rest of the map. So the run breaks and continues in a new frame.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.placement import Match, PlaneTracks, worth
from relmap.planes.scans.observation import PlaneObservation

SUPPORTED = 0.375
"""Fraction of the walls and corners of the poorer side that must agree on a motion."""
JUMP_M, JUMP = 0.5, 3.0
"""A step longer than this, and than this multiple of the usual one, is a jump."""
USUAL, KNOWN = 200, 5
"""Number of last steps that define the usual step, and the minimum number."""
CROSSING = np.sin(np.deg2rad(10.0)) ** 2
"""Smallest spread of wall directions that determines the motion along the walls."""
STEADY = 5
"""Number of scans whose typical motion is used as the prediction."""
VARYING = 20
"""Number of steps from which the variation of the speed is estimated."""
UNSURE = 0.05
"""Minimum uncertainty of a predicted step, as a fraction of it."""
FAST = 0.75
"""Quantile of the measured steps as long as which an unmeasured one may be."""
VARYING_M = 0.15
"""Steps that vary by more are not bridged if unmeasured."""


def is_supported(tracks: PlaneTracks, seen: PlaneObservation, match: Match) -> bool:
    """Return whether enough of the expected and of the observed walls match.

    A single other wall is tolerated: it may be clutter, or have just come into view.
    """
    recent = tracks.missed == tracks.missed.min(initial=0)
    return match.score >= SUPPORTED * (min(worth(tracks, seen, recent)) - 1)


def usual_motion(motions: Floats, measured: Bools | None = None) -> Floats:
    """Return the recent motion of the robot (3,): the median of its last motions (n, 3).

    With `measured` (n,) the step is that of the last motions whose length was measured, if there
    are enough: where none is measured, the robot is assumed to go on as before.
    """
    last = _middle(motions)
    if measured is not None:
        begin = max(len(measured) - VARYING, 0)
        rows = begin + np.flatnonzero(measured[begin:])
        rows = rows if len(rows) >= STEADY else np.flatnonzero(measured)
        if len(rows) >= STEADY:
            last[1:] = _middle(motions[rows[-STEADY:]])[1:]
    return last


def _middle(motions: Floats) -> Floats:
    """Return the median of the last motions (3,), zero if there are none."""
    last = np.sort(motions[-STEADY:], axis=0)
    return np.asarray(last[len(last) // 2]) if len(last) else np.zeros(3)


def farthest_m(before: Floats) -> float:
    """Return the longest plausible step from one scan to the next, metres.

    `before` (n, 3): yaw, x, y of all motions so far.
    """
    if len(before) < KNOWN:
        return np.inf
    last = np.sort(_lengths(before[-USUAL:]))
    return JUMP_M + JUMP * float(last[len(last) // 2])


def measured_along(tracks: PlaneTracks, seen: PlaneObservation, match: Match) -> bool:
    """Return whether matched walls determine the whole motion: by a corner, or by crossing."""
    known = np.isfinite(tracks.corner_at[match.tracks, :, 0])
    if (known & seen.static[match.walls]).any():
        return True
    of = np.zeros(len(match.walls), dtype=np.int64)
    return bool(spread(seen.along[match.walls], of, 1)[0] >= CROSSING)


def unsure_m(before: Floats) -> float:
    """Return the possible error of the length of an unmeasured step, metres.

    The step is predicted as the median of the last measured motions, of all (n, 3) so far; its
    uncertainty is their variation, or the whole step if fewer than `KNOWN` are measured.
    """
    if not len(before):
        return np.inf
    middle = float(np.median(_lengths(before[-VARYING:])))
    unsure = UNSURE if len(before) >= KNOWN else 1.0
    return max(varies_m(before) / float(np.sqrt(STEADY)), unsure * middle)


def varies_m(before: Floats) -> float:
    """Return how much the length of the last of all measured steps (n, 3) varies, metres."""
    if not len(before):
        return 0.0
    low, high = np.quantile(_lengths(before[-VARYING:]), (0.25, 0.75))
    return float(high - low) / 2


def slower_m(before: Floats, usual: Floats) -> float:
    """Return by how much a predicted motion (3,) is shorter than a fast one of (n, 3), metres.

    0 if the difference is within the minimum uncertainty. A robot that turned or stood before a
    corridor may go on there as usual, unnoticed.
    """
    if not len(before):
        return 0.0
    fast_m, usual_m = np.quantile(_lengths(before[-USUAL:]), FAST), np.hypot(*usual[1:])
    return float(fast_m - usual_m if usual_m < (1 - UNSURE) * fast_m else 0.0)


def _lengths(motions: Floats) -> Floats:
    return np.hypot(motions[:, 1], motions[:, 2])


def spread(along: Floats, of: Ints, n: int) -> Floats:
    """Return the spread (n,) of the wall directions (k, 2) of each of n scans.

    This is the smaller eigenvalue of the sum of the directions' outer products.
    """
    x, y = along.T
    xx, xy, yy = (np.bincount(of, v, minlength=n) for v in (x * x, x * y, y * y))
    return np.asarray((xx + yy) / 2 - np.hypot((xx - yy) / 2, xy))
