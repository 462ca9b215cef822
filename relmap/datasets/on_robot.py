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
SCANS = 20
"""Minimum number of scans."""
ONE_RAD = 1e-4
"""Beams closer to each other than this have one direction: echoes of one beam, rounded."""


def on_robot(path: Path, ranges_m: list[Floats], bearings_rad: list[Floats]) -> list[Bools]:
    """Return which beams of each scan end on the robot: list of k (b,).

    These move with the robot and would tell that it stands still. In their directions nine tenths
    of the scans have the same short range. `path`: the log, for the warning; `ranges_m`,
    `bearings_rad`, list of k (b,): beams of each scan; those of range 0 did not return.
    """
    own = [np.zeros(len(ranges), dtype=np.bool_) for ranges in ranges_m]
    steps = [np.diff(np.sort(bearings)) for bearings in bearings_rad]
    steps_rad = np.concatenate([*steps, np.zeros(1)])
    steps_rad = steps_rad[steps_rad > ONE_RAD]
    if len(ranges_m) < SCANS or not len(steps_rad) or not any((r > 0).any() for r in ranges_m):
        return own
    counts = [len(ranges) for ranges in ranges_m]
    every_m, bearings = np.concatenate(ranges_m), np.concatenate(bearings_rad)
    direction = np.rint((bearings - bearings.min()) / np.median(steps_rad))
    found = _near(every_m, direction.astype(np.int64), np.repeat(np.arange(len(counts)), counts))
    if found.any():
        _LOG.warning(
            "%s: %.3g %% of the beams end on the robot itself and are left out",
            shown(path),
            100 * found.mean(),
        )
    return np.split(found, np.cumsum(counts)[:-1])


def _near(ranges_m: Floats, direction: Ints, scan: Ints) -> Bools:
    """Return which beams (n,) end on the robot, given their directions and scans."""
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
        return np.zeros(len(ranges_m), dtype=np.bool_)
    fixed = (share >= MOSTLY) & (_farthest_m(usual_m) <= REACH_M)
    return np.asarray(fixed[direction] & (ranges_m > 0) & (ranges_m <= usual_m[direction] + SAME_M))


def _farthest_m(usual_m: Floats) -> Floats:
    """Return the largest range (d,) of the surface that each direction, in order, is part of.

    A wall beside which the robot drives goes on beyond its own parts; these end abruptly.
    """
    begins = np.abs(np.diff(usual_m, prepend=np.inf)) > SAME_M
    return np.asarray(np.maximum.reduceat(usual_m, np.flatnonzero(begins))[np.cumsum(begins) - 1])
