"""Metrics of planes in space, compared with the true faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.evaluation.metrics import align_poses
from relmap.planes3d.adjustment import across
from relmap.planes3d.table import Plane3dTable

NEAR_M, TURN = 0.05, np.cos(np.deg2rad(5.0))
"""Largest distance and rotation (cosine) between a plane and a face on which it lies."""
LEAST_M2 = 0.25
"""Smaller planes are not counted."""
SAMPLE_M, MOST_SAMPLES = 0.1, 2000
"""Spacing of the points at which planes are compared, and their approximate maximum number."""
MOSTLY = 0.5
"""Minimum fraction of a mapped plane that lies on the true one matched to it."""


@dataclass(frozen=True, eq=False)
class Faces:
    """True faces: f parallelograms.

    `plane` (f,): faces of one plane have one number; `corners` (f, 4, 3), map frame of the truth,
    metres: in order around the face; `seen_m2` (f,): area of each face that at least two scans saw.
    """

    plane: Ints
    corners: Floats
    seen_m2: Floats


def judge_planes(
    table: Plane3dTable, faces: Faces | None, poses: Floats, true_poses: Floats
) -> dict[str, float | None]:
    """Evaluate the mapped planes.

    `faces`: without any, only `doubled_area` is known; `poses`, `true_poses` (k, 4, 4): of the same
    instants; they align the map to the truth. Returns `plane_recall`, fraction of the true planes,
    of which at least 0.25 m2 were seen twice, that are mapped; `plane_precision`, fraction of the
    mapped planes over 0.25 m2 that lie on true ones; `doubled_area`, fraction of the mapped area
    covered by another mapped plane; `plane_rmse_m`, root mean square distance of the corners of
    mapped planes from the true planes on which they lie. Planes coincide within 0.05 m and 5
    degrees. None if there is nothing to compare.
    """
    figures: dict[str, float | None] = {"doubled_area": doubled_area(table)}
    if faces is None or not len(faces.plane) or not len(poses):
        return figures
    R, t = align_poses(poses, true_poses, 3)
    rows = np.flatnonzero((table.status == "static") & (table.area_m2 >= LEAST_M2)).tolist()
    off, own = [np.empty(0)], []
    for k in rows:
        points = surface_points(table, k) @ R.T + t
        found, face = _true_plane(points, R @ table.normal[k], faces)
        own.append(found)
        if found >= 0:
            corner, true_normal = faces.corners[face, 0], _normals(faces.corners)[face]
            off.append((table.outline[k] @ R.T + t - corner) @ true_normal)
    due = np.flatnonzero(np.bincount(faces.plane, faces.seen_m2) >= LEAST_M2)
    distance = np.concatenate(off)
    return figures | {
        "plane_recall": float(np.isin(due, own).mean()) if len(due) else None,
        "plane_precision": float((np.array(own) >= 0).mean()) if rows else None,
        "plane_rmse_m": float(np.sqrt((distance**2).mean())) if len(distance) else None,
    }


def doubled_area(table: Plane3dTable) -> float | None:
    """Return the fraction of the mapped area covered by another mapped plane with the same front.

    Planes with fronts on different sides, as of a thin wall, are different.
    """
    rows = np.flatnonzero(table.status == "static").tolist()
    points = {k: surface_points(table, k) for k in rows}
    doubled = 0.0
    for k in rows:
        on = np.zeros(len(points[k]), dtype=bool)
        for other in rows:
            if other != k and table.normal[k] @ table.normal[other] > TURN:
                off = points[k] @ table.normal[other] - table.offset[other]
                near = np.flatnonzero((np.abs(off) < NEAR_M) & ~on)
                on[near] = _inside(points[k][near], table, other)
        doubled += float(on.mean()) * table.area_m2[k] if len(on) else 0.0
    area = float(table.area_m2[rows].sum())
    return doubled / area if area else None


def surface_points(table: Plane3dTable, k: int) -> Floats:
    """Return points (n, 3) within the outline of a plane, at least the mean of its corners."""
    outline = table.outline[k]
    if len(outline) < 3:
        return np.asarray(table.centre[k][None])
    axes = np.concatenate(across(table.normal[k][None]))
    flat = (outline - table.centre[k]) @ axes.T
    size = np.ptp(flat, axis=0)
    most = max(np.sqrt(size.prod() / MOST_SAMPLES), size.max() / MOST_SAMPLES)
    step = max(SAMPLE_M, float(most))
    x, y = (np.arange(axis.min() + step / 2, axis.max(), step) for axis in flat.T)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    grid = grid[_within(grid, flat)]
    points = grid if len(grid) else flat.mean(axis=0, keepdims=True)
    return np.asarray(table.centre[k] + points @ axes)


def _inside(points: Floats, table: Plane3dTable, k: int) -> Bools:
    """Return which points (n, 3) lie within the outline of a plane, seen from its front."""
    if len(table.outline[k]) < 3:
        return np.zeros(len(points), dtype=bool)
    axes = np.concatenate(across(table.normal[k][None]))
    return _within(
        (points - table.centre[k]) @ axes.T, (table.outline[k] - table.centre[k]) @ axes.T
    )


def _within(points: Floats, outline: Floats) -> Bools:
    from matplotlib.path import Path

    return np.asarray(Path(outline).contains_points(points))


def _normals(corners: Floats) -> Floats:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))


def _true_plane(points: Floats, normal: Floats, faces: Faces) -> tuple[int, int]:
    """Return the true plane on which most of the points (n, 3) lie, and a face of it; -1 if few."""
    hits = np.zeros(len(faces.plane))
    for k in np.flatnonzero(np.abs(_normals(faces.corners) @ normal) > TURN):
        corners = faces.corners[k]
        sides = np.stack([corners[1] - corners[0], corners[3] - corners[0]])
        share = (points - corners[0]) @ np.linalg.pinv(sides)
        beyond = NEAR_M / np.linalg.norm(sides, axis=1)
        off = points - corners[0] - share @ sides
        inside = ((share > -beyond) & (share < 1 + beyond)).all(axis=1)
        hits[k] = (inside & (np.linalg.norm(off, axis=1) < NEAR_M)).mean()
    by_plane = np.bincount(faces.plane, hits)
    best = int(by_plane.argmax())
    if by_plane[best] < MOSTLY:
        return -1, -1
    return best, int(np.where(faces.plane == best, hits, -1.0).argmax())
