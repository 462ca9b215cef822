"""Which stretch of each wall a robot sees, and why it ends where it ends.

The world is 2½-D: vertical walls of one height, so what hides what is decided in the ground plane.
Every wall has one front: seen from there its ends (x0, y0), (x1, y1) go from right to left. From
behind a wall is not there; a wall with two sides is two walls, one for each side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

END_TYPES = ("corner", "view", "range", "occluded")
"""Why a stretch ends: in this order the reasons are asked for, the first that holds is given."""

_SAME_BEARING_RAD = 1e-12
"""Bearings this near are one and the same, apart only by rounding."""


@dataclass(frozen=True, eq=False)
class SeenWalls:
    """The visible stretches of walls in one scan, from right to left.

    Where something stands before the middle of a wall, the wall has more than one stretch.

    Attributes
    ----------
    wall : (s,) int64
        The wall that each stretch is part of.
    ends : (s, 2, 2) float64, robot frame, metres
        x, y of the right and the left end, as seen from the robot.
    end_type : (s, 2) str
        One of `END_TYPES`: the true end of the wall, cut by the edge of the view, by the range, or
        hidden behind another wall.
    """

    wall: NDArray[np.int64]
    ends: NDArray[np.float64]
    end_type: NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class _Clipped:
    """The parts of walls within view and range, as if nothing hid them: (m,) each."""

    wall: NDArray[np.int64]
    ends: NDArray[np.float64]
    kind: NDArray[np.int64]


def seen_walls(ends_robot: NDArray[np.float64], range_m: float, half_view_rad: float) -> SeenWalls:
    """Return what a robot sees of walls that do not cross.

    Parameters
    ----------
    ends_robot : (w, 2, 2) float64, robot frame, metres
        x, y of the two ends of each wall, right to left as seen from its front.
    range_m : float
        Horizontal range of the sensor, metres.
    half_view_rad : float
        The sensor sees bearings in [-half_view_rad, half_view_rad], at most a half turn in all.
    """
    parts = _clip(ends_robot, range_m, half_view_rad)
    bearings = np.arctan2(parts.ends[..., 1], parts.ends[..., 0])
    events, at = _merged(bearings)
    nearest = _nearest(ends_robot[parts.wall], at, (events[:-1] + events[1:]) / 2)
    changes = np.flatnonzero(np.diff(nearest, prepend=-2, append=-2))
    runs = np.column_stack([changes[:-1], changes[1:]])
    runs = runs[nearest[runs[:, 0]] >= 0]
    return _stretches(ends_robot, parts, at, nearest[runs[:, 0]], runs, events[runs])


def _clip(ends: NDArray[np.float64], range_m: float, half_view_rad: float) -> _Clipped:
    """Cut the walls that face the robot by both edges of the view and by the range."""
    wall = np.flatnonzero(_cross(ends[:, 0], ends[:, 1]) > 0)
    first, along = ends[wall, 0], ends[wall, 1] - ends[wall, 0]
    m = len(wall)
    low, high = np.zeros((m, 3)), np.ones((m, 3))
    for side in (-1.0, 1.0):
        # Inside is to the left of the right edge, and to the right of the left edge.
        edge = np.array([np.cos(half_view_rad), side * np.sin(half_view_rad)])
        f0, f1 = -side * _cross(edge, first), -side * _cross(edge, first + along)
        cut = f0 / np.where(f0 == f1, 1.0, f0 - f1)
        low[:, 1] = np.maximum(low[:, 1], np.where(f0 < 0, np.where(f1 > 0, cut, 2.0), 0.0))
        high[:, 1] = np.minimum(high[:, 1], np.where((f0 >= 0) & (f1 < 0), cut, 1.0))
    middle = -(first * along).sum(axis=1) / (along * along).sum(axis=1)
    nearest = first + middle[:, None] * along
    half = np.sqrt(np.maximum(range_m**2 - (nearest * nearest).sum(axis=1), 0.0))
    half /= np.linalg.norm(along, axis=1)
    low[:, 2], high[:, 2] = np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)
    kind = np.column_stack([np.argmax(low, axis=1), np.argmin(high, axis=1)])
    t = np.column_stack([low.max(axis=1), high.min(axis=1)])
    points = first[:, None] + t[..., None] * along[:, None]
    points = np.where((kind == 0)[..., None], ends[wall], points)
    inside = t[:, 0] < t[:, 1]
    return _Clipped(wall[inside], points[inside], kind[inside])


def _merged(bearings: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the different bearings in order, and for each given one which of them it is."""
    order = np.argsort(bearings, axis=None)
    ordered = bearings.ravel()[order]
    new = np.diff(ordered, prepend=-np.inf) > _SAME_BEARING_RAD
    at = np.empty(len(order), dtype=np.int64)
    at[order] = np.cumsum(new) - 1
    return ordered[new], at.reshape(bearings.shape)


def _nearest(
    ends: NDArray[np.float64], at: NDArray[np.int64], bearing: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return the first part that a ray between each two events meets; -1 where it meets none.

    As walls do not cross, it is the first one at every bearing between the two.
    """
    if not len(bearing):
        return np.empty(0, dtype=np.int64)
    gap = np.arange(len(bearing))[:, None]
    covers = (at[:, 0] <= gap) & (gap < at[:, 1])
    distance = np.where(covers, _distances(ends, bearing), np.inf)
    nearest = np.argmin(distance, axis=1)
    return np.where(covers.any(axis=1), nearest, -1)


def _distances(ends: NDArray[np.float64], bearing: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far along rays (k,) the lines of walls (m, 2, 2) are, (k, m), metres."""
    ray = np.column_stack([np.cos(bearing), np.sin(bearing)])[:, None]
    across = _cross(ray, ends[:, 1] - ends[:, 0])
    return np.asarray(_cross(ends[:, 0], ends[:, 1]) / np.where(across == 0, np.nan, across))


def _stretches(
    ends_robot: NDArray[np.float64],
    parts: _Clipped,
    at: NDArray[np.int64],
    part: NDArray[np.int64],
    runs: NDArray[np.int64],
    bearing: NDArray[np.float64],
) -> SeenWalls:
    """Turn runs of one nearest part (s,) between two events (s, 2) at bearings into stretches."""
    wall = parts.wall[part]
    line = ends_robot[wall]
    across = line[:, 1] - line[:, 0]
    ray = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    distance = _cross(line[:, 0], line[:, 1])[:, None] / _cross(ray, across[:, None])
    whole = at[part] == runs
    ends = np.where(whole[..., None], parts.ends[part], distance[..., None] * ray)
    kind = np.where(whole, parts.kind[part], END_TYPES.index("occluded"))
    return SeenWalls(wall, ends, np.array(END_TYPES)[kind])


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the z of the cross product of vectors in the plane, (..., 2) each."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
