"""Whether small free-standing objects stay in place, or walk about as people do."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.planes.linking.tying import Scans
from relmap.planes.motions import motion_over
from relmap.planes.scans.beams import BeamStore

LINKS = 200
"""Approximate number of links that are examined."""
APART_M, MOST_APART = 1.0, 10
"""Distance travelled between two compared scans, during which people walk on, and maximum number of
scans."""
UNKNOWN = 20
"""Points added to those that are gone: few points do not prove rest."""
OFTEN = 0.5
"""Fraction of the points above which such objects are used like all others."""


def share_at_rest(scans: Scans, is_tied: Bools, most: int = LINKS) -> float:
    """Return the fraction of the points on small free-standing objects that are still there later.

    `is_tied` (i,): whether the motion into each scan is accepted; `most`: approximate number of
    links to examine. Returns 0 if there is none.
    """
    there = gone = 0
    step_m = float(np.median(np.hypot(*scans.motions[:, 1:].T)))
    apart = int(np.clip(np.ceil(APART_M / max(step_m, 1e-3)), 1, MOST_APART))
    for later in range(apart, len(is_tied), 1 + len(is_tied) // most):
        between = slice(later - apart + 1, later + 1)
        if is_tied[between].all():
            motion = motion_over(scans.motions[between])
            seen = _seen_again(scans.beams, later - apart, later, motion)
            there, gone = there + seen[0], gone + seen[1]
    return there / (there + gone + UNKNOWN)


def _seen_again(beams: BeamStore, earlier: int, later: int, motion: Floats) -> tuple[int, int]:
    """Return how many points on loose objects of one scan are there, and gone, in a later one."""
    from relmap.planes.scans.loose_kernels import seen_again

    points, _, loose = beams.given(earlier).by_bearing
    given = beams.given(later)
    if not loose.any() or not len(given.points):
        return 0, 0
    found, bearings, _ = given.by_bearing
    return seen_again(points[loose], (found, bearings, given.origin), motion)
