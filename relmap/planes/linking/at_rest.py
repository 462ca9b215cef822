"""Whether small free-standing objects stay in place, or walk about as people do."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools
from relmap.planes.linking.tying import Scans
from relmap.planes.motions import motion_over

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
    from relmap.planes.scans.loose_kernels import seen_again

    there = gone = 0
    step_m = float(np.median(np.hypot(*scans.motions[:, 1:].T)))
    apart = int(np.clip(np.ceil(APART_M / max(step_m, 1e-3)), 1, MOST_APART))
    for later in range(apart, len(is_tied), 1 + len(is_tied) // most):
        between = slice(later - apart + 1, later + 1)
        if not is_tied[between].all():
            continue
        points, _, loose = scans.beams.given(later - apart).by_bearing
        given = scans.beams.given(later)
        if loose.any() and len(given.points):
            found, bearings, _ = given.by_bearing
            motion, seen = motion_over(scans.motions[between]), (found, bearings, given.origin)
            stays, goes = seen_again(points[loose], seen, motion)
            there, gone = there + stays, gone + goes
    return there / (there + gone + UNKNOWN)
