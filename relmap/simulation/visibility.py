"""Visible stretches of walls, and the reasons why they end.

The world is 2½-D: vertical walls of one height, so occlusion is decided in the ground plane. Every
wall has one front: seen from there its ends (x0, y0), (x1, y1) go from right to left. A wall is
invisible from behind; a two-sided wall is two walls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints

END_TYPES = ("corner", "view", "range", "occluded")
"""Why a stretch ends; if several reasons hold, the first is given."""

_SAME_BEARING_RAD = 1e-12
"""Bearings that differ by less are equal up to rounding."""


@dataclass(frozen=True, eq=False)
class SeenWalls:
    """The visible stretches of walls in one scan, from right to left.

    A wall with a hidden middle part has more than one stretch.

    `wall` (s,): the wall of each stretch; `ends` (s, 2, 2), robot frame, metres: x, y of the right
    and the left end, as seen from the robot; `end_type` (s, 2): one of `END_TYPES`: the true end of
    the wall, cut by the edge of the view, by the range, or hidden behind another wall.
    """

    wall: Ints
    ends: Floats
    end_type: NDArray[np.str_]


def seen_walls(ends_robot: Floats, range_m: float, half_view_rad: float) -> SeenWalls:
    """Return the visible stretches of walls that do not cross.

    `ends_robot` (w, 2, 2), robot frame, metres: x, y of the two ends of each wall, right to left as
    seen from its front; `range_m`: horizontal range of the sensor, metres; `half_view_rad`: the
    sensor sees bearings in [-half_view_rad, half_view_rad], less than a full turn in all.
    """
    if half_view_rad <= np.pi / 2:
        return _seen_ahead(ends_robot, range_m, half_view_rad)
    sides = []
    for middle in (-half_view_rad / 2, half_view_rad / 2):
        c, s = np.cos(middle), np.sin(middle)
        R = np.array([[c, -s], [s, c]])
        seen = _seen_ahead(ends_robot @ R, range_m, half_view_rad / 2)
        true = ends_robot[seen.wall]  # exact, where rounding would matter
        ends = np.where((seen.end_type == "corner")[..., None], true, seen.ends @ R.T)
        sides.append(replace(seen, ends=ends))
    return _joined(*sides)


def _joined(right: SeenWalls, left: SeenWalls) -> SeenWalls:
    """Combine both half turns: a wall straight ahead is one stretch."""
    wall = np.concatenate([right.wall, left.wall])
    ends, end_type = (
        np.concatenate([getattr(right, name), getattr(left, name)]) for name in ("ends", "end_type")
    )
    k = len(right.wall)
    if 0 < k < len(wall) and wall[k - 1] == wall[k] and end_type[k, 0] == "view":
        ends[k - 1, 1], end_type[k - 1, 1] = ends[k, 1], end_type[k, 1]
        wall, ends, end_type = (np.delete(part, k, axis=0) for part in (wall, ends, end_type))
    return SeenWalls(wall, ends, end_type)


def _seen_ahead(ends_robot: Floats, range_m: float, half_view_rad: float) -> SeenWalls:
    """Return the visible stretches within at most a half turn."""
    wall, ends, kind = _clipped(ends_robot, range_m, half_view_rad)
    bearings = np.arctan2(ends[..., 1], ends[..., 0])
    order = np.argsort(bearings, axis=None)
    ordered = bearings.ravel()[order]
    new = np.diff(ordered, prepend=-np.inf) > _SAME_BEARING_RAD
    events, at = ordered[new], np.empty(bearings.shape, dtype=np.int64)
    at.ravel()[order] = np.cumsum(new) - 1
    nearest = _nearest(ends_robot[wall], at, (events[:-1] + events[1:]) / 2)
    changes = np.flatnonzero(np.diff(nearest, prepend=-2, append=-2))
    runs = np.column_stack([changes[:-1], changes[1:]])
    runs = runs[nearest[runs[:, 0]] >= 0]
    part = nearest[runs[:, 0]]
    whole = at[part] == runs
    ray = np.stack([np.cos(events[runs]), np.sin(events[runs])], axis=-1)
    hidden = ray_distances(ends_robot[wall[part], None], events[runs])[..., None] * ray
    types = np.array(END_TYPES)[np.where(whole, kind[part], END_TYPES.index("occluded"))]
    return SeenWalls(wall[part], np.where(whole[..., None], ends[part], hidden), types)


def ray_distances(walls: Floats, bearing: Floats) -> Floats:
    """Return the distances along rays from the robot to the lines of walls.

    `walls` (..., 2, 2), robot frame, metres: two points of each line. `bearing` (...), radians:
    bearing of each ray; the arguments are broadcast. Returns (...), metres: NaN if the ray is
    parallel to the line.
    """
    first, last = walls[..., 0, :], walls[..., 1, :]
    across = _cross(np.stack([np.cos(bearing), np.sin(bearing)], axis=-1), last - first)
    return np.asarray(_cross(first, last) / np.where(across == 0, np.nan, across))


def _clipped(ends: Floats, range_m: float, half_view_rad: float) -> tuple[Ints, Floats, Ints]:
    """Clip the walls that face the robot to both edges of the view and to the range.

    Returns `wall` (m,), `ends` (m, 2, 2), `kind` (m, 2): as in `SeenWalls`, ignoring occlusion; the
    kinds are indices into `END_TYPES`.
    """
    wall = np.flatnonzero(_cross(ends[:, 0], ends[:, 1]) > 0)
    first, along = ends[wall, 0], ends[wall, 1] - ends[wall, 0]
    m = len(wall)
    low, high = np.zeros((m, 3)), np.ones((m, 3))
    for side in (-1.0, 1.0):
        # Inside is left of the right edge, and right of the left edge.
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
    return wall[inside], points[inside], kind[inside]


def _nearest(ends: Floats, at: Ints, bearing: Floats) -> Ints:
    """Return the first part hit at all bearings between two events, as no walls cross; or -1."""
    if not len(bearing):
        return np.empty(0, dtype=np.int64)
    gap = np.arange(len(bearing))[:, None]
    covers = (at[:, 0] <= gap) & (gap < at[:, 1])
    distance = np.where(covers, ray_distances(ends, bearing[:, None]), np.inf)
    return np.where(covers.any(axis=1), np.argmin(distance, axis=1), -1)


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the z of the cross product of vectors in the plane, (..., 2) each."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
