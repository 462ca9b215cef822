"""Landmarks that are not planes: their points scatter across them more than the noise.

A flight of stairs is grown as a slope where a scan has few points on each tread.
"""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.planes3d.submap import Submap

ROUGH, THIN = 3.0, 1e-3
"""The points of a plane have at most this many times the usual noise; noise below the second value,
a fraction of the range, counts as that much."""
BINS, FEW = 8, 20
"""Number of ranges at which the usual noise is found, and least number of patches at each."""


def is_rough(part: Submap) -> Bools:
    """Return which landmarks (l,) are rougher than the noise of the sensor.

    Observations count by their information: one that shows a plane outweighs many that are thick.
    """
    range_m = np.concatenate([np.linalg.norm(seen.centre, axis=1) for seen in part.seen])
    off_m = np.concatenate([seen.spread[:, 2] for seen in part.seen])
    weight = np.concatenate([seen.information[:, 2] for seen in part.seen])
    landmark = np.concatenate(part.match)
    sums = [
        np.bincount(landmark, weight * each**2, len(part))
        for each in (off_m, np.maximum(_usual_noise(range_m, off_m), THIN * range_m))
    ]
    return np.asarray(sums[0] > ROUGH**2 * sums[1])


def _usual_noise(range_m: Floats, off_m: Floats) -> Floats:
    """Return the median scatter (n,) of patches at the range of each."""
    order = np.argsort(range_m, kind="stable")
    parts = np.array_split(order, min(BINS, len(order) // FEW + 1))
    usual = [(np.median(range_m[rows]), np.median(off_m[rows])) for rows in parts]
    return np.asarray(np.interp(range_m, *np.array(usual).T))
