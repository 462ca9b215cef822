"""Small worlds with exact truth, for tests."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from relmap import Plane3dMapper, PlaneMapper, PointMapper
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.datasets.base import ObservationLog
from relmap.evaluation.metrics import ate, majority_ids, purity
from relmap.simulation import WorldSpec, simulate_world

Scans = list[tuple[Ints, Floats]]
M = TypeVar("M", PointMapper, PlaneMapper, Plane3dMapper)


@dataclass(frozen=True)
class Walk:
    """A robot that walks along a road of landmarks.

    ``landmarks`` (m, d) are in the frame of the first pose; ``scans`` are pairs of ids and points.
    """

    landmarks: Floats
    poses: list[tuple[Floats, Floats]]
    scans: Scans


OUTLINE = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 2.0], [2.0, 2.0], [2.0, 4.5], [0.0, 4.5]])
ROOM = np.stack([OUTLINE, np.roll(OUTLINE, -1, axis=0)], axis=1)
"""A room from inside, each wall from right to left."""


def random_rotation(dimension: int, angle: float, rng: np.random.Generator) -> Floats:
    """Return a rotation of up to `angle` radians about each axis."""
    if dimension == 2:
        return turn(rng.uniform(-angle, angle))
    return Rotation.from_euler("ZYX", rng.uniform(-angle, angle, 3)).as_matrix()


def turn(yaw: float | Floats) -> Floats:
    """Return the rotation in the plane by an angle, or by each of several (n,)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.moveaxis(np.array([[c, -s], [s, c]]), [0, 1], [-2, -1])


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


def fed(mapper: M, scans: Iterable[Any]) -> M:
    """Map scans; each is what `update` takes, or a tuple of it and the ids."""
    for scan in scans:
        mapper.update(*(scan if isinstance(scan, tuple) else (scan,)))
    return mapper


def finished(mapper: M, scans: Iterable[Any]) -> M:
    """Map scans to their end."""
    fed(mapper, scans).finish()
    return mapper


def refined(mapper: M, scans: Iterable[Any]) -> M:
    """Map scans to their end, and refine the map."""
    finished(mapper, scans).refine()
    return mapper


def seen(log: ObservationLog, known: bool = True) -> Iterator[tuple[Floats, Ints | None]]:
    """Yield the points of each scan, with their ids if they are to be known."""
    for scan in log.scans():
        yield scan.points_robot, scan.ids if known else None


def driven(log: ObservationLog) -> PointMapper:
    """Map a log, with its ids if it has any."""
    return finished(PointMapper(), seen(log))


def mapped(scans: Scans) -> PointMapper:
    """Map scans with known association."""
    return finished(PointMapper(), ((points, ids) for ids, points in scans))


def without_ids(log: ObservationLog) -> tuple[PointMapper, Ints]:
    """Map a log without its ids; return the mapper and the label of every observation."""
    mapper = PointMapper()
    labels = np.concatenate([mapper.update(points) for points, _ in seen(log)])
    mapper.finish()
    return mapper, labels


def mapped_world(spec: WorldSpec) -> tuple[PointMapper, float]:
    """Return the refined map of a world without ids, and its landmark RMSE, metres."""
    world, mapper = simulate_world(spec), PointMapper()
    labels = np.concatenate([mapper.update(scan.points_robot) for scan in world.log.scans()])
    mapper.finish()
    mapper.refine()
    true = stands_for(mapper.landmarks_of(labels), world.true_ids)
    known = np.array([label in true for label in mapper.map.landmark_ids.tolist()])
    ids = [true[label] for label in mapper.map.landmark_ids[known].tolist()]
    there = world.landmarks_map[np.searchsorted(world.landmark_ids, ids)]
    return mapper, aligned_rmse(mapper.map.positions[known], there)


def stands_for(landmarks: Ints, ids: Ints | None) -> dict[int, int]:
    """Return the id of most observations of each landmark."""
    return dict(zip(*majority_ids(landmarks, ids)[:2], strict=True))


def purity_of(landmarks: Ints, ids: Ints | None) -> float:
    return purity(landmarks, ids)


def ate_m(poses: Floats, true_poses: Floats | None, planar: bool = True) -> float:
    return ate(poses, true_poses, planar)


def submap_ate_m(submap: Any, true_poses: Floats | None) -> float:
    """Return the ATE of a submap of walls, of the scans it knows the pose of."""
    known = np.isfinite(submap.poses[:, 0, 0])
    return ate_m(submap.poses[known], true_poses[slice(*submap.span)][known])


def limit_of(log: ObservationLog, truth: Floats) -> float:
    """Return the RMSE of batch least squares with the ids of a log."""
    assert log.ids is not None
    batch = Batch(log.points_robot, log.iteration, log.ids)
    return aligned_rmse(batch_least_squares(batch, truth), truth)


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
