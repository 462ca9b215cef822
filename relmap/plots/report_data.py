"""The data shown in the report of a run, packed for its script.

Arrays are little-endian, in base 64: float32, int32, and uint16 for the points of scans.
"""

from __future__ import annotations

from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import Submap
from relmap.io.results import LEAST_SCANS, Result, SubmapPath
from relmap.planes.walls.files import DrawnSubmap, PlaneResult
from relmap.planes.walls.table import PlaneTable
from relmap.planes3d.files import Plane3dResult
from relmap.planes3d.table import Plane3dTable, is_mapped
from relmap.plots.path import jumps
from relmap.plots.planes import upward
from relmap.plots.run import weak_places
from relmap.plots.sheet import limits_of

POINTS = 60_000
"""Maximum number of scan points in the report, over all submaps."""
STEPS = 65_535
"""Quantisation steps over the range of the scan points' coordinates."""
View = dict[str, Any]


def views_of(result: Result) -> list[View]:
    """Return the data of each submap in its own frame, the map itself first."""
    if isinstance(result, PlaneResult):
        total = sum(len(submap.points) for submap in result.drawn)
        every = max(-(-total // POINTS), 1)
        return [_view_of_walls(k, submap, every) for k, submap in enumerate(result.drawn)]
    if isinstance(result, Plane3dResult):
        return [
            _view_of_planes(result, rank)
            for rank, path in enumerate(result.paths)
            if rank == 0 or len(path.poses) >= LEAST_SCANS
        ]
    others = zip(result.submaps[1:], result.paths[1:], strict=True)
    return [
        _view_of_points(result),
        *(_view_of_submap(k, *other, result.planar) for k, other in enumerate(others, start=1)),
    ]


def _view_of_walls(number: int, submap: DrawnSubmap, every: int) -> View:
    planes = submap.planes
    mapped = planes.status == "static"
    ends = planes.ends[mapped]
    wall, end = np.nonzero(planes.corner[mapped] >= 0)
    first = np.searchsorted(submap.iterations, planes.first_iteration[mapped])
    caption = f"{len(submap.poses)} scans, {len(ends)} walls, {len(wall)} corners"
    return {
        **_framed(number, caption, ends.reshape(-1, 2), submap.poses[:, :2, 3]),
        **_lines(ends, planes, np.flatnonzero(mapped), submap.iterations),
        "dots": _packed(ends[wall, end], "<f4"),
        "dotFirst": _packed(first[wall], "<i4"),
        **_path(submap.iterations, submap.stamps_s, submap.poses, 2),
        "weak": submap.weak.tolist(),
        **_points(submap.points[::every], submap.point_scan[::every]),
    }


def _view_of_planes(result: Plane3dResult, rank: int) -> View:
    """Return the edges of the planes of a submap, with its floor level."""
    planes, (iterations, stamps_s, poses) = result.planes, result.paths[rank]
    part, own = result.parts[rank], np.flatnonzero(planes.submap == rank)
    rows = own[is_mapped(part)[np.argsort(part.number, kind="stable")]].tolist()
    level = np.eye(4)
    level[:3, :3] = up = upward(planes, rows)
    rings = [planes.outline[k] @ up.T for k in rows]
    edges = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings]
    ends = np.concatenate([np.empty((0, 2, 3)), *edges])
    of = np.repeat(np.array(rows, dtype=np.int64), [len(ring) for ring in rings])
    weak = np.flatnonzero(np.isin(iterations, result.summary["weak_links"]))
    caption = f"{len(poses)} scans, {len(rows)} planes"
    return {
        **_framed(rank, caption, ends.reshape(-1, 3), (level @ poses)[:, :3, 3]),
        **_lines(ends, planes, of, iterations),
        **_path(iterations, stamps_s, level @ poses, 3),
        "weak": weak[weak > 0].tolist(),
    }


def _view_of_points(result: Result) -> View:
    table, kept, axes = result.landmarks, result.mapped, 2 if result.planar else 3
    at, iterations = table.position[kept][:, :axes], result.iterations
    assert iterations is not None
    caption = f"{len(result.poses)} poses, {len(at)} landmarks"
    return {
        **_framed(0, caption, at, result.poses[:, :axes, 3]),
        "dots": _packed(at, "<f4"),
        "dotNames": _packed(table.landmark[kept], "<i8"),
        "dotSeen": _packed(table.observations[kept], "<i4"),
        "dotFirst": _packed(np.searchsorted(iterations, table.first_iteration[kept]), "<i4"),
        **_path(iterations, result.stamps_s, result.poses, axes),
        "rings": [
            {"name": name, "at": _packed(at[:, :axes], "<f4")}
            for name, at in weak_places(result).items()
            if len(at)
        ],
    }


def _view_of_submap(number: int, submap: Submap, path: SubmapPath, planar: bool) -> View:
    axes = 2 if planar else 3
    at = submap.positions[:, :axes]
    return {
        **_framed(
            number, f"{len(path.poses)} poses, {len(at)} landmarks", at, path.poses[:, :axes, 3]
        ),
        "dots": _packed(at, "<f4"),
        "dotNames": _packed(submap.landmark_ids, "<i8"),
        **_path(*path, axes),
    }


def _framed(number: int, caption: str, places: Floats, way: Floats) -> View:
    """Return what every view has: its name, caption, axes, and the limits of what it shows first.

    `places` (n, d), `way` (k, d): mapped places and the path, for the limits.
    """
    name = f"submap {number}" if number else "map"
    limits = [limit.tolist() for limit in limits_of(places, way)]
    return {"name": name, "caption": caption, "axes": places.shape[1], "limits": limits}


def _lines(ends: Floats, table: PlaneTable | Plane3dTable, rows: Ints, iterations: Ints) -> View:
    """Return lines (n, 2, d), each of a plane in a row (n,) of the table."""
    first = np.searchsorted(iterations, table.first_iteration[rows])
    return {
        "lines": _packed(ends, "<f4"),
        "lineNames": _packed(table.plane[rows], "<i4"),
        "lineSeen": _packed(table.observations[rows], "<i4"),
        "lineFirst": _packed(first, "<i4"),
    }


def _path(iterations: Ints, stamps_s: Floats, poses: NDArray[Any], axes: int) -> View:
    """Return positions and headings of the robot, their times, and where the path jumps."""
    position = poses[:, :axes, 3]
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    timed = np.isfinite(stamps_s).all() and not np.array_equal(stamps_s, iterations)
    return {
        "path": _packed(position, "<f4"),
        "yaw": _packed(yaw, "<f4"),
        "iterations": _packed(iterations, "<i4"),
        "stamps": _packed(stamps_s, "<f8") if timed else None,
        "leaps": (1 + np.flatnonzero(jumps(position))).tolist(),
    }


def _points(points: Floats, scan: Ints) -> View:
    """Return quantised points with their range, and the scan of each."""
    if not len(points):
        return {}
    low, high = points.min(axis=0), points.max(axis=0)
    step = np.maximum((high - low) / STEPS, 1e-9)
    return {
        "points": _packed(np.rint((points - low) / step), "<u2"),
        "pointLow": low.tolist(),
        "pointStep": step.tolist(),
        # The scan numbers ascend, so the first point of each scan is sufficient.
        "pointFrom": _packed(np.searchsorted(scan, np.arange(int(scan[-1]) + 2)), "<i4"),
    }


def _packed(values: NDArray[Any], kind: str) -> str:
    return b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode()
