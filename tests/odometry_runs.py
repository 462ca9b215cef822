"""Figure eights with noisy odometry, and their maps of points."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.simulation.figure_eight import FigureEight, simulate_figure_eight

Array = Floats
SPARSE, DENSE = 3.0, 25.0
WAY, ANGLE = 0.01, np.deg2rad(0.1)
"""Noise of odometry: share of the way, and angle about each axis in a step."""


@cache
def world(density: float, iterations: int) -> FigureEight:
    return simulate_figure_eight(density=density, iterations=iterations, seed=1)


def odometry_of(run: FigureEight, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    poses = run.trajectory
    motions = np.tile(np.eye(4), (len(poses), 1, 1))
    motions[1:] = np.linalg.inv(poses[:-1]) @ poses[1:]
    way = np.linalg.norm(motions[:, :3, 3], axis=1)
    motions[:, :3, 3] += WAY * way[:, None] * rng.normal(size=(len(poses), 3))
    turns = Rotation.from_rotvec(ANGLE * rng.normal(size=(len(poses), 3))).as_matrix()
    motions[:, :3, :3] = motions[:, :3, :3] @ turns
    return motions


def finished(
    run: FigureEight, motions: Array | None, known: bool, journal: Path | None = None
) -> tuple[PointMapper, Ints]:
    mapper, labels = PointMapper(journal=journal), []
    for k, scan in enumerate(run.log.scans()):
        motion = None if motions is None or not k else motions[k]
        ids = scan.ids if known else None
        labels.append(mapper.update(scan.points_robot, ids=ids, odometry=motion))
    mapper.finish()
    return mapper, np.concatenate(labels)


def mapped(
    run: FigureEight, motions: Array | None, known: bool, journal: Path | None = None
) -> tuple[PointMapper, Ints]:
    mapper, labels = finished(run, motions, known, journal)
    mapper.refine()
    return mapper, labels


def rmse_m(run: FigureEight, positions: Array, ids: Ints) -> float:
    true = run.landmarks_map[np.searchsorted(run.landmark_ids, ids)]
    R, t = fit_rigid(positions, true)
    return float(np.sqrt(np.mean(np.sum((positions @ R.T + t - true) ** 2, axis=1))))
