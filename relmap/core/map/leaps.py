"""Where nothing but what places look like connects the scans of a map.

No landmark is tracked across such a gap, or none was seen for long: another place that looks the
same may be taken for the one before it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.registering import BLIND
from relmap.core.refinement.condensing import LENGTH, SegmentRows
from relmap.core.state.table import NONE

USUAL, LEAP = 0.95, 3.0
"""Quantile of the steps between connected scans that is the usual one, and multiple of it beyond
which a step across a gap is a leap."""


@dataclass(frozen=True, eq=False)
class Gaps:
    """Gaps of a map that landmarks do not bridge.

    Attributes
    ----------
    before, after : (g,) int64
        Last iteration with a pose before each, and first one after it.
    way_m : (g,) float64, metres
        Distance of the two poses.
    reach_m : (g,) float64, metres
        Distance that the robot covers in this time at its usual speed.
    """

    before: Ints
    after: Ints
    way_m: Floats
    reach_m: Floats

    @property
    def leaps(self) -> Ints:
        """Rows (l,) of the gaps in which the robot would be much faster than usual."""
        return np.flatnonzero(self.way_m > LEAP * self.reach_m)


def gaps_of(rows: SegmentRows, positions_map: Floats, of: Ints, poses: Floats) -> Gaps:
    """Return the gaps of a map across which too few landmarks were tracked to determine a pose.

    Also those of more than `BLIND` scans without a pose.

    `rows`: of all iterations, by the numbers under which landmarks were seen; `positions_map`
    (m, d), map frame, metres: NaN for unmapped landmarks; `of` (m,): landmark of each number;
    `poses` (k, 4, 4), metres: NaN where undetermined.
    """
    d, known = positions_map.shape[1], np.flatnonzero(np.isfinite(poses[:, 0, 0]))
    if len(known) < 2:
        return Gaps(known[:0], known[:0], np.empty(0), np.empty(0))
    before, after = known[:-1], known[1:]
    way_m = np.linalg.norm(np.diff(poses[known, :d, 3], axis=0), axis=1)
    row, bit = np.nonzero((rows.visible[:, None] >> np.arange(LENGTH)) & 1)
    row, scan = rows.landmark[row], rows.first_iteration[rows.segment[row]] + bit
    first, last = np.full(len(of), len(poses)), np.full(len(of), NONE)
    np.minimum.at(first, row, scan)
    np.maximum.at(last, row, scan)
    mapped = (last != NONE) & np.isfinite(positions_map[of]).all(axis=1)
    begun, ended = (np.bincount(at[mapped], minlength=len(poses)) for at in (first, last))
    tracked = np.cumsum(begun - ended)  # across the end of each iteration
    linked = np.minimum.reduceat(tracked[: known[-1]], before) >= d
    linked &= after - before <= BLIND  # then tracks may have been continued at another place
    each_m = way_m / (after - before)
    usual_m = float(np.quantile(each_m[linked], USUAL)) if linked.any() else np.inf
    kept = np.flatnonzero(~linked)
    reach_m = np.asarray(usual_m * (after - before)[kept], dtype=np.float64)
    return Gaps(before[kept], after[kept], way_m[kept], reach_m)
