"""Clouds of a tilted sensor, levelled and reduced to what a 2-D laser would see of the walls.

The vertical is the direction that most planes of a cloud are either parallel or perpendicular to:
the normal of floor and ceiling, and the common axis of the walls.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.scan import checked_points, numbers
from relmap.segmentation.space.patches import Patches
from relmap.segmentation.space.segmenter import PatchSegmenter

TILT = np.cos(np.deg2rad(40.0))
"""The z axis of the sensor is within this angle of the vertical (cosine)."""
SKEW = np.sin(np.deg2rad(20.0))
"""Two walls with normals closer to parallel than this (sine) do not determine the vertical."""
ALIKE, UPRIGHT = np.sin(np.deg2rad(4.0)), np.sin(np.deg2rad(10.0))
"""Deviation of level and upright planes that determine the vertical, and of walls that are kept."""
LEAST = 0.5
"""Minimum fraction of the surface that is level or upright."""
AHEAD = np.cos(np.deg2rad(1.0))
"""A given vertical is at least this far from the x axis (cosine)."""
ROUNDS = 3
"""Refinements of the vertical."""
BEAMS = 720
"""Directions in which the farthest wall is kept."""
NOTHING = np.empty((0, 2))
TILTED = np.sin(np.deg2rad(15.0))
"""Largest vertical component of the normal of an upright plane."""
MOST_SHARE = 0.15
"""Largest fraction of points on planes that are not upright."""


def vertical(patches: Patches) -> Floats | None:
    """Return the vertical from the planes of one cloud.

    `patches`: sensor frame. Returns (3,): unit vector within 40 degrees of z; None if no direction
    has half of the surface parallel or perpendicular to it, or if the planes do not determine one.
    """
    size = np.bincount(patches.cell_patch, minlength=len(patches)).astype(np.float64)
    candidates = _candidates(patches.normal)
    if not len(candidates):
        return None
    along = np.abs(candidates @ patches.normal.T)
    fits = ((along < ALIKE) | (along > np.sqrt(1 - ALIKE**2))).astype(np.float64) @ size
    up, best = candidates[int(fits.argmax())], float(fits.max())
    if best < LEAST * size.sum():
        return None
    for _ in range(ROUNDS):
        along = np.abs(patches.normal @ up)
        weight = size * (along < ALIKE) - size * (along > np.sqrt(1 - ALIKE**2))
        moment = (patches.normal * weight[:, None]).T @ patches.normal
        axis = np.linalg.eigh(moment)[1][:, 0]
        up = axis * np.sign(axis @ up)
    return np.asarray(up)


def level_scan(points: ArrayLike, segmenter: PatchSegmenter, up: ArrayLike | None = None) -> Floats:
    """Reduce a cloud to a level 2-D scan of its walls.

    Parameters
    ----------
    points : (n, 3) array, sensor frame, metres
    segmenter : PatchSegmenter
    up : (3,) array, sensor frame, optional
        The vertical, of any length, as an IMU gives it; estimated from the planes by default.

    Returns
    -------
    (b, 2) float64, metres
        Level frame with its origin at the sensor: x ahead, y left. In each of 720 directions a
        point of the farthest wall, from right to left. Empty without a vertical.

    Raises
    ------
    RelmapError
        If the points are 2-D, a coordinate is not finite, or `up` is not a direction, or is that of
        the x axis.
    """
    given = None if up is None else _checked_up(up)
    points = checked_points(points, 0)
    patches = segmenter.fit(points).patches_
    axis = vertical(patches) if given is None and len(patches) else given
    if axis is None:
        return NOTHING
    walls = np.append(np.abs(patches.normal @ axis) < UPRIGHT, False)
    rows = np.flatnonzero(walls[segmenter.labels_])
    x = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    axes = np.stack([x / np.linalg.norm(x), np.cross(axis, x) / np.linalg.norm(x)])
    return _beams(points[rows] @ axes.T, segmenter.labels_[rows])


def _checked_up(up: ArrayLike) -> Floats:
    """Return a direction (3,) as a unit vector; RelmapError if it is none, or the x axis."""
    given = numbers(up, "up", "(3,) numbers")
    length = np.linalg.norm(given)
    if given.shape != (3,) or not 0 < length < np.inf or abs(given[0]) > AHEAD * length:
        raise RelmapError(
            f"up is {given.tolist()}; it must be a direction (3,) in the frame of the sensor, at "
            "least a degree off its x axis"
        )
    return np.asarray(given / length)


def _candidates(normal: Floats) -> Floats:
    """Return normals and axes of two planes each that may be vertical, (c, 3), upwards."""
    a, b = np.triu_indices(len(normal), 1)
    axis = np.cross(normal[a], normal[b])
    sine = np.linalg.norm(axis, axis=1)
    axis = axis[sine > SKEW] / sine[sine > SKEW, None]
    candidates = np.concatenate([normal, axis])
    candidates = candidates * np.where(candidates[:, 2:] < 0, -1.0, 1.0)
    return np.asarray(candidates[candidates[:, 2] > TILT])


def _beams(points: Floats, wall: Ints) -> Floats:
    """Return a point of the farthest wall in each direction: that of middle range among its own."""
    range_m = np.hypot(*points.T)
    share = (np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (2 * np.pi)
    beam = np.minimum((BEAMS * share).astype(np.int64), BEAMS - 1)
    order = np.lexsort((range_m, beam))
    last = np.append(np.flatnonzero(np.diff(beam[order])), len(order) - 1)[: len(order)]
    farthest = np.full(BEAMS, -1)
    farthest[beam[order][last]] = wall[order][last]
    order = order[wall[order] == farthest[beam[order]]]
    first = np.flatnonzero(np.diff(beam[order], prepend=-1))
    count = np.diff(np.append(first, len(order)))
    return np.asarray(points[order[first + count // 2]])


def require_upright(xyz: Floats) -> None:
    """Raise a `RelmapError` if too many points (n, 3) lie on planes that are not upright."""
    share = tilted_share(xyz)
    if share > MOST_SHARE:
        raise RelmapError(
            f"{share:.0%} of a scan's points lie on surfaces that are not upright, such as floors, "
            "ceilings or scans of a tilted sensor; expected walls: level such clouds with --level "
            "auto (relmap.segmentation.space.level_scan), or map them with --variant planes3d "
            "(Plane3dMapper)"
        )


def tilted_share(xyz: Floats) -> float:
    """Return the fraction of points (n, 3) on planes that are not upright."""
    segmenter = PatchSegmenter().fit(xyz)
    tilted = np.abs(segmenter.patches_.normal[:, 2]) > TILTED
    return float(np.append(tilted, False)[segmenter.labels_].mean())
