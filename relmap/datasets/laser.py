"""Scans of a 2-D laser, without the beams that say nothing of the world around.

Some did not return, at a range that the log may not state; others hit the robot itself, as a mast
or a cable, or what it pushes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints, evenly
from relmap.core.errors import RelmapError
from relmap.datasets.bearing_scale import warn_of_bearings
from relmap.datasets.floor_hits import floor_m
from relmap.datasets.rounding import spread_rounded
from relmap.datasets.scans import ScanLog, SensorView
from relmap.datasets.textfile import invalid, warn

MAX_BEAMS, MAX_SCANS = 1 << 24, 1 << 18
"""Maximum number of beams and scans of a laser log: some fifty thousand scans of 360 beams."""
FIXED = 1e-3
"""Allowed variation of the pose of a laser on the robot, due to rounding: metres and radians."""
SAME = 3e-4
"""Largest relative difference of ranges that are the same: coordinates may be rounded."""
FARTHEST_M = 10_000.0
"""No sensor reaches as far: where all points are beyond, they are in another frame or unit."""
WIDE_RAD = np.deg2rad(10.0)
"""Angle of neighbouring beams of the same range. Those on a wall ahead are the same over less, also
if ranges are rounded to 0.01 m, unless it is less than 2 m away."""
WIDE_SCANS = 3
"""Minimum number of scans with such beams."""
JITTER_M = 0.2
"""Ranges of beams without a return that vary: the median of those this far below the largest range
is the middle of a peak, ..."""
PEAK, PEAK_SCANS = 5.0, 0.1
"""... that holds this many times as many as the same width below it. Minimum fraction of the scans
with such beams, in sectors wider than any straight wall within the peak."""
REPEATED = 10
"""Minimum number of scans whose largest range is the same if hardly any beams end just below it or
beyond: down a corridor only a few do not return, and no wall stays at one range as the robot
moves."""
REACH_M, SAME_M = 1.0, 0.1
"""Largest range of the robot's own parts, or of what it pushes, and by how much it varies: noise,
vibration."""
MOSTLY, SELDOM, CHANGING = 0.9, 0.75, 0.1
"""Fraction of the scans in which such a direction has the same range; the largest such fraction of
a direction that changes, two thirds along a corridor; and which fraction of the other directions
must change: if the robot stands, none does."""
SCANS, MOST = 20, 2000
"""Minimum number of scans, and how many, spread over the log, are searched for own parts."""
ONE_RAD = 1e-4
"""Beams closer to each other than this have one direction: echoes of one beam, rounded."""


def require_memory(where: str, scans: int, beams: int) -> None:
    """Raise a `RelmapError` if a laser log exceeds the limits of scans or beams."""
    if scans > MAX_SCANS or beams > MAX_BEAMS:
        problem = f"more than {MAX_SCANS} scans or {MAX_BEAMS} beams, expected at most that"
        raise RelmapError(f"{where}: {problem}")


@dataclass(frozen=True, eq=False)
class Beams:
    """The beams of one scan of a 2-D laser, from right to left.

    `ranges_m`, `bearings_rad` (b,); a range of 0 or less, which some lasers use for errors, is not
    a return. `T_robot_laser`: x, y (metres) and yaw (radians) of the laser on the robot.
    """

    ranges_m: Floats
    bearings_rad: Floats
    T_robot_laser: Sequence[float]


def laser_scans(
    path: Path, scans: Sequence[Beams], limit_m: float, stamps_s: Floats, poses: Floats | None
) -> ScanLog:
    """Make a log of k 2-D laser scans, without the beams that have no return or hit the robot.

    `path`: the log, for warnings. A range of `limit_m` or more is not a return; see also
    `usable_beams`. `stamps_s` (k,); `poses` (k, 4, 4): T_reference_robot.
    """
    ranges_m = [scan.ranges_m for scan in scans]
    below = sum(int((ranges < 0).sum()) for ranges in ranges_m)
    if below:
        warn(path, f"{below} ranges below 0 are treated as no return")
    usable, limit_m = usable_beams(path, ranges_m, [scan.bearings_rad for scan in scans], limit_m)
    kept = [ranges[there] for ranges, there in zip(ranges_m, usable, strict=True)]
    points = []
    for scan, there, r in zip(scans, usable, spread_rounded(path, kept), strict=True):
        x, y, yaw = scan.T_robot_laser
        angle = scan.bearings_rad[there] + yaw
        points.append(np.column_stack([x + r * np.cos(angle), y + r * np.sin(angle)]))
    return ScanLog(2, stamps_s, points.__getitem__, poses, sensor=_view(scans, limit_m))


def _view(scans: Sequence[Beams], limit_m: float) -> SensorView:
    """Return the properties common to all scans; empty if the laser is not fixed on the robot."""
    T_robot_laser = np.array([scan.T_robot_laser for scan in scans])
    if np.ptp(T_robot_laser, axis=0).max() > FIXED:
        return SensorView()
    bearings = [scan.bearings_rad for scan in scans if len(scan.bearings_rad)]
    half = min(min(-bearing.min(), bearing.max()) for bearing in bearings)
    view_rad = 2 * float(half) if half > 0 else None
    range_m = float(limit_m) if np.isfinite(limit_m) else None
    return SensorView(view_rad, range_m, *T_robot_laser[0].tolist())


def usable_beams(
    path: Path,
    ranges_m: list[Floats],
    bearings_rad: list[Floats],
    limit_m: float = np.inf,
    range_m: float = np.inf,
) -> tuple[list[Bools], float]:
    """Return which beams of each scan, list of k (b,), are usable, and the range below which.

    `path`: the log, for warnings. `ranges_m`, `bearings_rad`, list of k (b,): beams of each scan,
    in their order. `limit_m`: the range of beams without a return as stated by the log; see also
    `no_return_m`, `floor_m` and `on_robot`. `range_m`: that of the laser, if beams without a return
    are missing. RelmapError as for `require_near`.
    """
    require_near(path, ranges_m)
    below_m = [np.where(ranges < limit_m, ranges, 0.0) for ranges in ranges_m]
    limit_m = min(limit_m, no_return_m(path, below_m, bearings_rad))
    below_m = [np.where(ranges < limit_m, ranges, 0.0) for ranges in below_m]
    limit_m = min(limit_m, floor_m(path, below_m, bearings_rad, min(limit_m, range_m)))
    known_m = [np.where((r > 0) & (r < limit_m), r, 0.0) for r in ranges_m]
    warn_of_bearings(path, known_m, bearings_rad)
    own = on_robot(path, known_m, bearings_rad)
    return [(r > 0) & ~robot for r, robot in zip(known_m, own, strict=True)], limit_m


def points_of_laser(
    path: Path, beams: list[Floats], stamps_s: Floats, sensor: SensorView
) -> ScanLog:
    """Make a log of k scans of the points (n, 2) of beams, without those that are not usable.

    See `usable_beams`. Points at the origin have no return. `sensor`: with its range, if known.
    """
    ranges_m = [np.hypot(*scan.T) for scan in beams]
    bearings_rad = [np.arctan2(scan[:, 1], scan[:, 0]) for scan in beams]
    range_m = sensor.range_m or np.inf
    usable, limit_m = usable_beams(path, ranges_m, bearings_rad, range_m=range_m)
    if np.isfinite(limit_m):
        sensor = replace(sensor, range_m=min(limit_m, range_m))
    given_m = [ranges[there] for ranges, there in zip(ranges_m, usable, strict=True)]
    points = [
        scan[there] * (new / given)[:, None]
        for scan, there, given, new in zip(
            beams, usable, given_m, spread_rounded(path, given_m), strict=True
        )
    ]
    return ScanLog(2, stamps_s, points.__getitem__, sensor=sensor)


def require_near(path: Path, ranges_m: Sequence[Floats]) -> None:
    """Raise a `RelmapError` if all points of all scans, (n,) each, are too far for any sensor."""
    nearest_m = min(float(r[r > 0].min(initial=np.inf)) for r in [*ranges_m, np.zeros(1)])
    if FARTHEST_M < nearest_m < np.inf:
        found = f"no point is nearer than {nearest_m:.4g} m"
        raise invalid(path, f"{found}, expected metres, in the frame of the sensor")


def no_return_m(path: Path, ranges_m: list[Floats], bearings_rad: list[Floats]) -> float:
    """Return the range from which beams are without a return, infinity if there are none.

    It is that of wide sectors in several scans, the largest of the log or the lower end of a narrow
    peak there; or one that many scans have, and hardly any beams near it or beyond. No wall looks
    like this from several places. Parameters as for `usable_beams`.
    """
    every = np.concatenate([*ranges_m, np.zeros(1)])
    largest_m = float(every.max())
    repeated_m = _repeated_m(every, ranges_m)
    for least_m, most_m, fewest in (
        (largest_m * (1 - SAME), largest_m, WIDE_SCANS),
        (_peak_m(every), largest_m, max(WIDE_SCANS, PEAK_SCANS * len(ranges_m))),
        (repeated_m * (1 - SAME), repeated_m, 0),
    ):
        if not 0 < least_m < np.inf:
            continue
        straight_rad = 2 * np.arccos(least_m / most_m)
        wide = sum(
            _widest_rad(ranges >= least_m, bearings) > max(WIDE_RAD, straight_rad)
            for ranges, bearings in zip(ranges_m, bearings_rad, strict=True)
        )
        if wide >= fewest:
            exact = least_m >= most_m * (1 - SAME)
            before = "" if exact else f"or at most {most_m - least_m:.2g} m before it, "
            beams = f"{100 * np.mean(every[:-1] >= least_m):.3g} % of the beams end"
            at = f"at the largest range, {most_m:.4g} m, {before}and are treated as no return"
            warn(path, f"{beams} {at}")
            return least_m
    return np.inf


def _peak_m(ranges_m: Floats) -> float:
    """Return the lower end of a narrow peak at the largest range, infinity if there is none."""
    largest_m = ranges_m.max()
    middle_m = np.median(ranges_m[ranges_m >= largest_m - JITTER_M])
    least_m = float((2 * middle_m - largest_m) * (1 - SAME))
    lower_m = 2 * least_m - largest_m
    n_below = np.count_nonzero((ranges_m >= lower_m) & (ranges_m < least_m))
    return least_m if np.count_nonzero(ranges_m >= least_m) >= PEAK * n_below else np.inf


def _repeated_m(every_m: Floats, ranges_m: list[Floats]) -> float:
    """Return which of all ranges (n,) stands alone at the far end of many scans, or infinity."""
    changed = [now for before, now in pairwise(ranges_m) if not np.array_equal(before, now)]
    farthest_m = np.sort([ranges.max(initial=0.0) for ranges in changed])
    farthest_m = farthest_m[farthest_m > 0]
    if len(farthest_m) < REPEATED:
        return np.inf
    ends = np.searchsorted(farthest_m, farthest_m * (1 + SAME), "right")
    counts = ends - np.arange(len(ends))
    most = int(np.argmax(counts))
    same_m = float(farthest_m[ends[most] - 1])
    same = np.count_nonzero(np.abs(every_m - same_m) <= SAME * same_m)
    others = np.count_nonzero(every_m >= same_m - JITTER_M) - same
    return same_m if counts[most] >= REPEATED and same >= PEAK * others else np.inf


def _widest_rad(chosen: Bools, bearings_rad: Floats) -> float:
    """Return the angle of the widest sector of chosen beams (b,)."""
    if not chosen.any():
        return 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen, [0]])))
    turn = bearings_rad[edges[1::2] - 1] - bearings_rad[edges[::2]]
    return float(np.abs(np.mod(turn + np.pi, 2 * np.pi) - np.pi).max())


def on_robot(path: Path, ranges_m: list[Floats], bearings_rad: list[Floats]) -> list[Bools]:
    """Return which beams of each scan end on the robot, or on what it pushes: list of k (b,).

    These move with the robot and would tell that it stands still. In their directions nine tenths
    of the scans have the same short range. Parameters as for `usable_beams`; beams of range 0 did
    not return.
    """
    none = [np.zeros(len(ranges), dtype=np.bool_) for ranges in ranges_m]
    if len(ranges_m) < SCANS:
        return none
    some = evenly(len(ranges_m), MOST).tolist()
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
        on = "on the robot itself, or on what it pushes,"
        warn(path, f"{100 * share:.3g} % of the beams end {on} and are left out")
    return own


def _own_m(ranges_m: Floats, direction: Ints, scan: Ints) -> Floats:
    """Return up to which range (d,) beams (n,) of each direction end on the robot; 0 for none."""
    returned = np.flatnonzero(ranges_m > 0)
    order = returned[np.lexsort((ranges_m[returned], direction[returned]))]
    begins = np.flatnonzero(np.diff(direction[order], prepend=-1))
    counts = np.diff(np.append(begins, len(order)))
    usual_m = np.zeros(direction.max(initial=0) + 1)
    usual_m[direction[order[begins]]] = ranges_m[order[begins + counts // 2]]
    same = (ranges_m > 0) & (np.abs(ranges_m - usual_m[direction]) <= SAME_M)
    seen = np.unique(np.column_stack([direction[same], scan[same]]), axis=0)[:, 0]
    share = np.bincount(seen, minlength=len(usual_m)) / len(np.unique(scan))
    # A wall beside which the robot drives goes on beyond its own parts; these end abruptly.
    ends = np.abs(np.diff(usual_m, prepend=np.inf)) > SAME_M
    farthest_m = np.maximum.reduceat(usual_m, np.flatnonzero(ends))[np.cumsum(ends) - 1]
    fixed = (share >= MOSTLY) & (farthest_m <= REACH_M)
    others = share[(usual_m > 0) & ~fixed]
    moves = len(others) > 0 and np.quantile(others, CHANGING) <= SELDOM
    return np.where(fixed & moves, usual_m + SAME_M, 0.0)
