"""The range from which a 2-D laser that is tilted a little sees the floor instead of walls."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.geometry.robust import median
from relmap.datasets.textfile import warn

AHEAD_RAD = np.deg2rad(10.0)
"""Beams at most this far from straight ahead: the floor there is a line across them."""
FAR, FARTHER = 0.99, 2 / 3
"""Quantile of the views ahead that is the far end of the peak, against single wild ranges; and
the fraction of it above which views count for the middle of the peak."""
NARROW = 0.75
"""Least ratio of the ends of the peak: a laser that shakes sees the floor sometimes nearer."""
PEAK, SCANS = 5.0, 0.1
"""Such a peak holds this many times as many views as the same width below it, and at least this
fraction of all."""
NEARER = 0.5
"""The same fraction is shorter than this fraction of the longest: else the robot may stand before a
wall, or drive about in the middle of a room."""
BELOW = 0.9
"""Fraction of the range of the laser above which that range is why nothing is seen farther."""
LINE, WIDE_RAD = 0.9, np.deg2rad(2.5)
"""The fraction of a view ahead above which beams end on the same line across, and the least angle
of these beams on a floor: walls on both sides that leave the range of the laser show a degree each
at most, a tenth of `AHEAD_RAD`. Then that range, unknown, is why nothing is seen farther."""
FEWEST = 20
"""Minimum number of scans."""
MOVED_M, MOVED = 0.1, 0.05
"""Change of a range, and the fraction of the beams that change so much since the last scan that is
counted: else the robot rests, and what it sees ahead is as far as before."""


def floor_m(
    path: Path, ranges_m: list[Floats], bearings_rad: list[Floats], limit_m: float = np.inf
) -> float:
    """Return the range from which beams may end on the floor, infinity if none do.

    The floor moves with the robot as a wall ahead would, at nearly the same distance in many scans,
    with hardly anything beyond. `path`: the log, for warnings. `ranges_m`, `bearings_rad`, list of
    k (b,): beams of each scan, 0 for those without a return. `limit_m`: range of the laser.
    """
    views = [_ahead(*scan) for scan in _moving(zip(ranges_m, bearings_rad, strict=True))]
    seen = np.array([view for view in views if view[0] > 0])
    if len(seen) < FEWEST:
        return np.inf
    ahead_m, across_rad = seen.T
    far_m = float(np.quantile(ahead_m, FAR))
    least_m = 2 * float(np.median(ahead_m[ahead_m >= FARTHER * far_m])) - far_m
    within = np.count_nonzero(ahead_m >= least_m)
    below = np.count_nonzero((ahead_m < least_m) & (ahead_m >= 2 * least_m - far_m))
    nearer = np.count_nonzero(ahead_m < NEARER * far_m)
    few = min(within, nearer) < SCANS * len(ahead_m)
    if few or within < PEAK * below or least_m < NARROW * far_m or far_m > BELOW * limit_m:
        return np.inf
    share = f"{100 * within / len(views):.3g} % of the scans in motion"
    found = f"{share} see {least_m:.3g} to {far_m:.3g} m ahead, hardly any farther"
    is_floor = np.median(across_rad[ahead_m >= least_m]) >= WIDE_RAD
    why = "the laser saw the floor" if is_floor else "its range, which the log lacks, ended there"
    warn(path, f"{found}, as if {why}: ranges left out")
    return least_m


def _ahead(ranges: Floats, bearings: Floats) -> tuple[float, float]:
    """Return how far a scan sees ahead, and the angle of the beams that end about there."""
    view_m = (ranges * np.cos(bearings))[np.abs(bearings) <= AHEAD_RAD]
    longest_m = float(view_m.max(initial=0.0))
    spacing = median(np.abs(np.diff(bearings))) if len(bearings) > 1 else 0.0
    return longest_m, float(spacing * np.count_nonzero(view_m >= LINE * longest_m))


def _moving(scans: Iterable[tuple[Floats, Floats]]) -> Iterator[tuple[Floats, Floats]]:
    """Yield the ranges and bearings (b,) of scans that differ from the last one yielded."""
    last = np.empty(0)
    for ranges, bearings in scans:
        same = len(ranges) == len(last)
        if not same or np.count_nonzero(np.abs(ranges - last) > MOVED_M) > MOVED * len(ranges):
            last = ranges
            yield ranges, bearings
