"""The poses and landmarks as a graph in g2o format."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.exports.content import MapContent
from relmap.exports.sight import Sightings, as_mapped

PLANAR = ("SE2", "XY", "SE2_XY")
SPATIAL = ("SE3:QUAT", "TRACKXYZ", "SE3_TRACKXYZ")
SENSOR = 0
"""Number of the sensor at the robot's origin: edges to points in space refer to one."""


def g2o_text(content: MapContent, seen: Sightings | None) -> str:
    """Return the graph: a vertex per pose, and an edge from each pose to the next.

    relmap estimates no motion, so an edge between poses is their relative pose in the map, with the
    identity as information matrix. For points the landmarks are vertices too, after the poses, and
    each observation is an edge: with the log as measured, with the information matrix from the
    estimated noise, otherwise as computed from the map.

    `seen`: for points, the observations.
    """
    planar, poses = content.result.planar, content.result.poses
    pose, point, sight = PLANAR if planar else SPATIAL
    lines = [f"VERTEX_{pose} {k} {_pose(T, planar)}" for k, T in enumerate(poses)]
    if content.walls is None:
        first, d = len(poses), 2 if planar else 3
        if not planar:
            lines.append(f"PARAMS_SE3OFFSET {SENSOR} 0 0 0 0 0 0 1")
        lines += [
            f"VERTEX_{point} {first + k} {_numbers(position)}"
            for k, position in enumerate(content.landmarks.position[:, :d].tolist())
        ]
    steps = np.linalg.inv(poses[:-1]) @ poses[1:]
    unit = _upper(np.eye(3 if planar else 6))
    lines += [f"EDGE_{pose} {k} {k + 1} {_pose(T, planar)} {unit}" for k, T in enumerate(steps)]
    if seen is not None:
        lines += _sights(content, seen, f"EDGE_{sight}")
    return "\n".join(lines) + "\n"


def _sights(content: MapContent, seen: Sightings, tag: str) -> Iterator[str]:
    points, weight = as_mapped(content, seen), 1.0
    if seen.points_robot is not None:
        refinement = content.result.summary.get("refinement")
        noise_m = refinement.get("noise_m") if isinstance(refinement, dict) else None
        points = seen.points_robot
        weight = 1.0 / noise_m**2 if isinstance(noise_m, float) and noise_m > 0 else 1.0
    about = _upper(weight * np.eye(points.shape[1]))
    sensor = "" if content.result.planar else f" {SENSOR}"
    n_poses = len(content.result.poses)
    vertices = zip(seen.pose.tolist(), (n_poses + seen.landmark).tolist(), strict=True)
    for (a, b), point in zip(vertices, points.tolist(), strict=True):
        yield f"{tag} {a} {b}{sensor} {_numbers(point)} {about}"


def _pose(T: Floats, planar: bool) -> str:
    if planar:
        return _numbers([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])
    return _numbers([*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)])


def _upper(information: Floats) -> str:
    """Return the upper triangle of a symmetric matrix, row by row."""
    return _numbers(information[np.triu_indices(len(information))].tolist())


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
