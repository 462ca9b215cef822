"""Initial estimate of the noise of a scan."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints

WINDOWS = 100
LEVELS = 20
NEIGHBOURS = 10
COLUMN_RAD = 1e-5
FLOOR_M = 1e-9
"""Noise below this is treated as zero."""
THINNER = 0.15
"""Minimum fraction of the windows without a corner."""
EVEN = 0.7
"""Minimum fraction of uniform steps between bearings for points on beams."""
OF_EXTENT = 0.09
"""Fraction of the scan's extent used if no window shows a wall."""


def window_noise(xy: Floats, rng: np.random.Generator) -> float:
    """Return the noise or slightly more (metres, standard deviation across a wall).

    Windows about random points are grown until they are elongated; the thickness of the thinner
    ones is the noise. Windows with a corner are too thick, so a large noise may be overestimated by
    a factor of two.
    """
    from relmap.segmentation.em.window_kernels import window_thickness

    if points_per_beam(xy) > 1:
        return max(_column_noise(xy), FLOOR_M)
    extent = float(np.hypot(*np.ptp(xy, axis=0)))
    at = rng.integers(0, len(xy), min(WINDOWS, 2 * len(xy)))
    smallest = max(2 * neighbour_distance(xy), FLOOR_M)
    radii = np.geomspace(smallest, max(extent, 2 * smallest), LEVELS)
    thick = window_thickness(xy, at, radii)
    seen = thick[np.isfinite(thick)]
    thin = np.quantile(seen, THINNER) if len(seen) else OF_EXTENT * extent
    return max(float(thin), FLOOR_M)


def neighbour_distance(xy: Floats) -> float:
    """Return the median distance (metres) of a point to its tenth neighbour.

    Of points at one bearing only one counts, and correspondingly fewer neighbours.
    """
    apart = xy[_distinct(xy)]
    k = max(round(NEIGHBOURS * len(apart) / len(xy)), 2)
    some = apart[:: max(len(apart) // 300, 1)]
    distance, _ = cKDTree(apart).query(some, k=[min(k + 1, len(apart))])
    return float(np.median(distance))


def points_per_beam(xy: Floats) -> float:
    """Return how many points lie at one bearing: those of one column of a 3-D sensor's beams.

    Together they locate a wall, but at most one of them bounds its extent.
    """
    repeat = len(xy) / len(_distinct(xy))
    return repeat if repeat > 1.5 else 1.0


def beam_angle(xy: Floats) -> float:
    """Return the angle (radians) between the beams of points (n, 2); 0 if they are not on beams.

    They are on beams if several lie at one bearing, or if nearly all steps between bearings are
    multiples of one angle.
    """
    step = np.diff(np.sort(np.arctan2(xy[:, 1], xy[:, 0])[_distinct(xy)]))
    usual = float(np.median(step)) if len(step) else 0.0
    multiple = step / max(usual, 1e-12)
    even = len(step) and np.mean(np.abs(multiple - np.round(multiple)) < 0.05) > EVEN
    return usual if even or points_per_beam(xy) > 1 else 0.0


def _column_noise(xy: Floats) -> float:
    """Return the noise (metres) of ranges: a column of beams meets one wall at one distance."""
    bearing = np.arctan2(xy[:, 1], xy[:, 0])
    _, column = np.unique(np.round(bearing / COLUMN_RAD), return_inverse=True)
    radius, count = np.hypot(xy[:, 0], xy[:, 1]), np.bincount(column)
    mean = np.bincount(column, weights=radius) / count
    squares = np.bincount(column, weights=(radius - mean[column]) ** 2)
    several = count > 2
    if not several.any():
        return 0.0
    return float(np.sqrt(np.median(squares[several] / (count[several] - 1))))


def _distinct(xy: Floats) -> Ints:
    """Return the row of one point at each bearing."""
    bearing = np.arctan2(xy[:, 1], xy[:, 0])
    return np.unique(np.round(bearing / COLUMN_RAD), return_index=True)[1]
