"""Where nothing but what places look like connects the scans of a map.

No landmark is tracked across such a gap, or none was seen for long: another place that looks the
same may be taken for the one before it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.association.registering import BLIND
from relmap.core.refinement.condensing import LENGTH, SegmentRows
from relmap.core.state.table import NONE

USUAL, LEAP = 0.95, 3.0
"""Fraction of the way that the robot covers in steps no longer than the usual one, and multiple of
it beyond which a step across a gap is a leap."""

_BITS = (np.arange(2**LENGTH)[:, None] >> np.arange(LENGTH)) & 1
LOWEST, HIGHEST = _BITS.argmax(axis=1), LENGTH - 1 - _BITS[:, ::-1].argmax(axis=1)
"""First and last iteration of a segment in which a landmark is seen, by its bits."""


@dataclass(frozen=True, eq=False)
class Gaps:
    """Gaps of a map that landmarks do not bridge.

    `before`, `after` (g,): last iteration with a pose before each, and first one after it; `way_m`
    (g,): distance of the two poses; `reach_m` (g,): that at the robot's usual speed.
    """

    before: Ints
    after: Ints
    way_m: Floats
    reach_m: Floats

    @property
    def missed(self) -> Ints:
        """Number of iterations without a pose in each gap, (g,)."""
        return self.after - self.before - 1

    @property
    def leaps(self) -> Ints:
        """Rows (l,) of the gaps in which the robot would be much faster than usual."""
        return np.flatnonzero(self.way_m > LEAP * self.reach_m)


def gaps_of(
    rows: SegmentRows, positions_map: Floats, of: Ints, known: Ints, places_map: Floats
) -> Gaps:
    """Return the gaps of a map across which too few landmarks were tracked to determine a pose.

    Gaps of more than `BLIND` scans without a pose are among them.

    `rows`: of all iterations, by the numbers under which landmarks were seen; `positions_map`
    (m, d), map frame, metres: NaN for unmapped landmarks; `of` (m,): landmark of each number;
    `known` (k,): iterations with a pose, ascending; `places_map` (k, 3), metres.
    """
    if len(known) < 2:
        return Gaps(known[:0], known[:0], np.empty(0), np.empty(0))
    before, after = known[:-1], known[1:]
    way_m = np.linalg.norm(np.diff(places_map, axis=0), axis=1)
    mapped = np.asarray(np.isfinite(positions_map[of]).all(axis=1))
    tracked = _tracked(rows, mapped)
    linked = np.minimum.reduceat(tracked[: known[-1]], before) >= positions_map.shape[1]
    linked &= after - before <= BLIND + 1  # then tracks may have been continued at another place
    each_m = np.sort((way_m / (after - before))[linked])
    covered = np.searchsorted(np.cumsum(each_m), USUAL * each_m.sum())
    usual_m = float(each_m[covered]) if len(each_m) else np.inf
    kept = np.flatnonzero(~linked)
    reach_m = np.asarray(usual_m * (after - before)[kept], dtype=np.float64)
    return Gaps(before[kept], after[kept], way_m[kept], reach_m)


def may_have_gaps(rows: SegmentRows, positions_map: Floats, of: Ints) -> bool:
    """Return False if enough landmarks are in view, and tracked, for `gaps_of` to find no gap.

    It does not need the poses. The arguments are those of `gaps_of`.
    """
    d, n = positions_map.shape[1], len(rows.iteration_segment)
    mapped = np.asarray(np.isfinite(positions_map[of]).all(axis=1))
    scan = rows.only(np.flatnonzero(mapped[rows.landmark])).sightings[1]
    showing = np.flatnonzero(np.bincount(scan, minlength=n) >= d)
    if len(showing) < 2:
        return True
    tracked = _tracked(rows, mapped)[showing[0] : showing[-1]]
    return bool((tracked < d).any() or np.diff(showing).max() > BLIND + 1)


def _tracked(rows: SegmentRows, mapped: Bools) -> Ints:
    """Return how many mapped landmarks (m,) are tracked across the end of each iteration (i,)."""
    n = len(rows.iteration_segment)
    first, last = np.full(len(mapped), n), np.full(len(mapped), NONE)
    begin = rows.first_iteration[rows.segment]
    np.minimum.at(first, rows.landmark, begin + LOWEST[rows.visible])
    np.maximum.at(last, rows.landmark, begin + HIGHEST[rows.visible])
    seen = mapped & (last != NONE)
    begun, ended = (np.bincount(at[seen], minlength=n) for at in (first, last))
    return np.cumsum(begun - ended)
