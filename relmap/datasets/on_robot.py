"""Beams of a laser that hit the robot itself: a mast, a cable or the edge of its cover."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.datasets.textfile import shown

_LOG = logging.getLogger(__name__)
REACH_M, SAME_M = 0.6, 0.1
"""Largest range of the robot's own parts, and by how much it varies: noise, vibration."""
MOSTLY, SELDOM, CHANGING = 0.9, 0.5, 0.1
"""Fraction of the scans in which such a direction has the same range; and the fraction of all
directions in which at most half of the scans must have it: if the robot stands, none changes."""
SCANS, MOST = 20, 2000
"""Minimum number of scans, and how many, spread over the log, are searched for own parts."""
ONE_RAD = 1e-4
"""Beams closer to each other than this have one direction: echoes of one beam, rounded."""


def on_robot(path: Path, ranges_m: list[Floats], bearings_rad: list[Floats]) -> list[Bools]:
    """Return which beams of each scan end on the robot: list of k (b,).

    These move with the robot and would tell that it stands still. In their directions nine tenths
    of the scans have the same short range. `path`: the log, for the warning; `ranges_m`,
    `bearings_rad`, list of k (b,): beams of each scan; those of range 0 did not return.
    """
    none = [np.zeros(len(ranges), dtype=np.bool_) for ranges in ranges_m]
    if len(ranges_m) < SCANS:
        return none
    some = np.unique(np.linspace(0, len(ranges_m) - 1, MOST).astype(np.int64)).tolist()
    some_m = np.concatenate([ranges_m[i] for i in some])
    steps_rad = np.concatenate([np.diff(np.sort(bearings_rad[i])) for i in some])
    steps_rad = steps_rad[steps_rad > ONE_RAD]
    if not len(steps_rad) or not (some_m > 0).any():
        return none
    first_rad = min(bearings.min(initial=np.inf) for bearings in bearings_rad)
    step_rad = np.median(steps_rad)
    direction = [np.rint((one - first_rad) / step_rad).astype(np.int64) for one in bearings_rad]
    scan = np.repeat(np.arange(len(some)), [len(ranges_m[i]) for i in some])
    limit_m = _own_m(some_m, np.concatenate([direction[i] for i in some]), scan)
    limit_m = np.append(limit_m, np.zeros(1 + max(one.max(initial=0) for one in direction)))
    beams = zip(ranges_m, direction, strict=True)
    own = [(ranges > 0) & (ranges <= limit_m[where]) for ranges, where in beams]
    if share := np.concatenate(own).mean():
        _LOG.warning(
            "%s: %.3g %% of the beams end on the robot itself and are left out",
            shown(path),
            100 * share,
        )
    return own


def _own_m(ranges_m: Floats, direction: Ints, scan: Ints) -> Floats:
    """Return the range (d,) up to which beams of each direction end on the robot; 0 for none.

    `ranges_m`, `direction`, `scan` (n,): of each beam.
    """
    returned = np.flatnonzero(ranges_m > 0)
    order = returned[np.lexsort((ranges_m[returned], direction[returned]))]
    begins = np.flatnonzero(np.diff(direction[order], prepend=-1))
    counts = np.diff(np.append(begins, len(order)))
    usual_m = np.zeros(direction.max(initial=0) + 1)
    usual_m[direction[order[begins]]] = ranges_m[order[begins + counts // 2]]
    same = (ranges_m > 0) & (np.abs(ranges_m - usual_m[direction]) <= SAME_M)
    seen = np.unique(np.column_stack([direction[same], scan[same]]), axis=0)[:, 0]
    share = np.bincount(seen, minlength=len(usual_m)) / len(np.unique(scan))
    if np.quantile(share[usual_m > 0], CHANGING) > SELDOM:
        return np.zeros(len(usual_m))
    fixed = (share >= MOSTLY) & (_farthest_m(usual_m) <= REACH_M)
    return np.where(fixed, usual_m + SAME_M, 0.0)


def _farthest_m(usual_m: Floats) -> Floats:
    """Return the largest range (d,) of the surface that each direction, in order, is part of.

    A wall beside which the robot drives goes on beyond its own parts; these end abruptly.
    """
    begins = np.abs(np.diff(usual_m, prepend=np.inf)) > SAME_M
    return np.asarray(np.maximum.reduceat(usual_m, np.flatnonzero(begins))[np.cumsum(begins) - 1])
