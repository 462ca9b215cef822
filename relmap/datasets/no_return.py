"""The range that beams without a return have in a log that does not state it."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.datasets.textfile import shown

_LOG = logging.getLogger(__name__)
SAME = 3e-4
"""Largest relative difference of ranges that are the same: coordinates may be rounded."""
WIDE_RAD = np.deg2rad(10.0)
"""Angle of neighbouring beams of the same range. Those on a wall ahead are the same over less, also
if ranges are rounded to 0.01 m, unless it is less than 2 m away."""
SCANS = 3
"""Minimum number of scans with such beams."""


def no_return_m(path: Path, ranges_m: list[Floats], bearings_rad: list[Floats]) -> float:
    """Return the range of beams without a return, infinity if there are none.

    It is the largest one of a log if in several scans wide sectors have it: no wall looks like this
    from several places. `path`: the log, for the warning; `ranges_m`, `bearings_rad`, list of k
    (b,): beams of each scan, in their order.
    """
    every = np.concatenate([*ranges_m, np.zeros(1)])
    least = float(every.max() * (1 - SAME))
    wide = sum(
        _widest_rad(ranges >= least, bearings) > WIDE_RAD
        for ranges, bearings in zip(ranges_m, bearings_rad, strict=True)
    )
    if wide < SCANS or least <= 0:
        return np.inf
    _LOG.warning(
        "%s: %.3g %% of the beams end at the largest range, %.4g m, and are treated as no return",
        shown(path),
        100 * np.mean(every[:-1] >= least),
        every.max(),
    )
    return least


def _widest_rad(chosen: Bools, bearings_rad: Floats) -> float:
    """Return the angle of the widest sector of chosen beams (b,)."""
    if not chosen.any():
        return 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen, [0]])))
    turn = bearings_rad[edges[1::2] - 1] - bearings_rad[edges[::2]]
    return float(np.abs(np.mod(turn + np.pi, 2 * np.pi) - np.pi).max())
