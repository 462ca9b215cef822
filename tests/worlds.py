"""Small worlds with exact truth, for tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.datasets.base import ObservationLog

Scans = list[tuple[Ints, Floats]]


@dataclass(frozen=True)
class Walk:
    """A robot that walks along a road of landmarks.

    ``landmarks`` (m, d) are in the frame of the first pose; ``scans`` are pairs of ids and points.
    """

    landmarks: Floats
    poses: list[tuple[Floats, Floats]]
    scans: list[tuple[Ints, Floats]]


def random_rotation(dimension: int, angle: float, rng: np.random.Generator) -> Floats:
    """Return a rotation of up to `angle` radians about each axis."""
    if dimension == 2:
        a = rng.uniform(-angle, angle)
        return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    return Rotation.from_euler("ZYX", rng.uniform(-angle, angle, 3)).as_matrix()


def walk(dimension: int, seed: int, sigma: float = 0.0, iterations: int = 120) -> Walk:
    """Walk along x through landmarks 2 m apart, seeing those up to 8 m before and behind."""
    rng = np.random.default_rng(seed)
    m = iterations // 5
    road = np.column_stack([np.arange(m) * 2.0 - 8.0, rng.uniform(-6, 6, (m, dimension - 1))])
    scans, poses = [], []
    first_R = random_rotation(dimension, 1.0, rng)
    for k in range(iterations):
        R = random_rotation(dimension, 0.1, rng) @ first_R
        t = np.concatenate([[0.25 * k], rng.uniform(-0.2, 0.2, dimension - 1)])
        seen = rng.permutation(np.flatnonzero(np.abs(road[:, 0] - t[0]) < 8.0))
        noise = sigma * rng.standard_normal((len(seen), dimension))
        scans.append((seen, (road[seen] - t) @ R + noise))
        poses.append((R, t))
    R0, t0 = poses[0]
    return Walk((road - t0) @ R0, poses, scans)


def driven(log: ObservationLog) -> PointMapper:
    """Map a log, with its ids if it has any."""
    mapper = PointMapper()
    for scan in log.scans():
        mapper.update(scan.points_robot, scan.ids)
    mapper.finish()
    return mapper


def mapped(scans: list[tuple[Ints, Floats]]) -> PointMapper:
    """Map scans with known association."""
    mapper = PointMapper()
    for ids, points in scans:
        mapper.update(points, ids)
    mapper.finish()
    return mapper


def aligned_rmse(positions: Floats, truth: Floats) -> float:
    """Return the root mean squared distance after rigid alignment."""
    R, t = fit_rigid(positions, truth)
    return float(np.sqrt(np.mean(np.sum((positions @ R.T + t - truth) ** 2, axis=1))))


def spacing(points: Floats) -> float:
    """Return the median distance of points (n, d) to their nearest neighbours."""
    return float(np.median(np.sort(np.linalg.norm(points[:, None] - points, axis=2), axis=1)[:, 1]))


def two_visits(dimension: int, seed: int, sigma: float = 0.02) -> tuple[Floats, Scans]:
    """Map a place, leave it through a stretch where nothing lasts, and come back to it, briefly.

    Returns
    -------
    place : (40, d) float64
        Landmarks at least 1 m apart, the ids their rows; nearly all are in view in each visit.
    scans : list of (ids, points)
        Of 40 scans, 60 of next to nothing, and 3 to 19.  What is seen once only has the id -1.
    """
    rng = np.random.default_rng(seed)
    place = rng.uniform(-8, 8, (500, dimension))
    apart = np.linalg.norm(place[:, None] - place, axis=2) + 9 * np.tri(500).T
    place = place[apart.min(axis=1) > 1.0][:40]
    scans: Scans = []
    for n in (40, int(rng.integers(3, 20))):
        R, t = random_rotation(dimension, 3.0, rng), rng.uniform(-1, 1, dimension)
        for _ in range(n):
            t = t + rng.normal(0, 0.1, dimension)
            R = random_rotation(dimension, 0.02, rng) @ R
            ids = rng.permutation(np.flatnonzero(np.linalg.norm(place - t, axis=1) < 9))
            noise = sigma * rng.standard_normal((len(ids), dimension))
            scans.append((ids, (place[ids] - t) @ R + noise))
        scans += [(np.full(4, -1), rng.uniform(-8, 8, (4, dimension))) for _ in range(10)]
        scans += [(ids[:0], place[:0])] * 50
    return place, scans[:-60]
