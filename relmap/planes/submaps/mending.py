"""Links a period of the walls off, which are replaced by the usual step."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.motions import inverse
from relmap.planes.submaps.periods import (
    APART_M,
    BACK_M,
    clear_steps,
    usual_instead,
    usual_of,
)

REST_M = 0.03
"""A robot at rest seems to move by less."""
LEAST, SHARE = 3, 0.5
"""Minimum number of clear steps near the usual one, and fraction of those of a moving robot, which
may change its speed."""
STRETCH, SKIPPED = 3, 1
"""Minimum number of such links in a row, and maximum number of others in between; links that lead
backwards may be alone."""


def periods_off(links: LinkRecord) -> dict[int, Floats]:
    """Return the motions (3,) into some scans that replace links a period off, by scan.

    A link is replaced if it differs from the usual step by more than 0.3 m, and a motion near that
    is open; see `maybe_periods_off`. Since it may be right if the robot changes its speed, that of
    the clear steps must be steady.
    """
    tied, scans = _compared(links), links.scans
    if not len(tied):
        return {}
    steps = inverse(links.motions[tied])
    clear_m = clear_steps(scans, tied - 1, tied, steps)
    if not _is_steady(clear_m):
        return {}
    usual_m = usual_of(clear_m)
    motions = usual_instead(scans, tied - 1, tied, steps, usual_m)
    off = np.hypot(*(motions[:, 1:] - usual_m).T) <= APART_M
    off &= (np.hypot(*steps[:, 1:].T) > REST_M) & ~np.isin(tied, [*links.instead])
    ahead_m = steps[off, 1:] @ usual_m / np.hypot(*usual_m)
    off[off] = _in_stretches(tied[off]) | (ahead_m < -BACK_M)
    return dict(zip(tied[off].tolist(), inverse(motions[off]), strict=True))


def _is_steady(clear_m: Floats) -> bool:
    """Return whether most clear translations (c, 2) of a moving robot are alike, and long."""
    if len(clear_m) < LEAST:
        return False
    usual_m, moving = usual_of(clear_m), np.hypot(*clear_m.T) > REST_M
    steady = moving & (np.hypot(*(clear_m - usual_m).T) < APART_M)
    is_long = bool(np.hypot(*usual_m) > APART_M)
    return is_long and bool(steady.sum() >= max(LEAST, SHARE * moving.sum()))


def _compared(links: LinkRecord) -> Ints:
    """Return the scans (k,) of a laser that are linked to the one before; none if steps are alike.

    Also none with odometry, and if further logs were added.
    """
    none = np.empty(0, dtype=np.int64)
    tied = 1 + np.flatnonzero((np.diff(links.submaps) == 0) & (links.submaps[1:] >= 0))
    if not len(tied) or len(links.wheels.given) or len(links.begun):
        return none
    if np.hypot(*np.ptp(inverse(links.motions[tied])[:, 1:], axis=0)) <= APART_M:
        return none
    beams = links.scans.beams_of
    shown = [min(len(beams(k - 1)), len(beams(k))) > 0 for k in tied.tolist()]
    return np.asarray(tied[np.array(shown, dtype=np.bool_)])


def _in_stretches(scans: Ints) -> Bools:
    """Return which scans (k,), ascending, are in a row of several."""
    row = np.cumsum(np.diff(scans, prepend=scans[:1]) > 1 + SKIPPED)
    return np.asarray(np.bincount(row)[row] >= STRETCH)
