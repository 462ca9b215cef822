"""Clouds of a log in space, and functions that change them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.evaluation.space import Faces


@dataclass
class Clouds:
    """Clouds (n, 3), the poses (4, 4) where they were taken, one for each scan, and the faces."""

    points: list[Floats]
    poses: Floats
    faces: Faces | None = None

    def only(self, rows: slice) -> Clouds:
        """Return some of the scans."""
        return Clouds(self.points[rows], self.poses[rows])

    def changed(self, change: Callable[[int, Floats], Floats]) -> Clouds:
        """Return clouds changed one by one."""
        return Clouds([change(k, cloud) for k, cloud in enumerate(self.points)], self.poses)

    def tilted(self, most_rad: float) -> Clouds:
        """Return clouds of a sensor with a random tilt in each scan."""
        rng = np.random.default_rng(0)
        axes = rng.standard_normal((len(self.points), 3))
        axes *= most_rad * rng.uniform(size=(len(axes), 1)) / np.linalg.norm(axes, axis=1)[:, None]
        turn = Rotation.from_rotvec(axes).as_matrix()
        poses = self.poses.copy()
        poses[:, :3, :3] = poses[:, :3, :3] @ turn
        return Clouds([cloud @ R for cloud, R in zip(self.points, turn, strict=True)], poses)


def noise(sigma: float, depth: bool = False) -> Callable[[int, Floats], Floats]:
    """Return a function that adds noise along rays; of a depth camera, by the squared depth."""

    def noisy(k: int, cloud: Floats) -> Floats:
        range_m = np.linalg.norm(cloud, axis=1, keepdims=True)
        off = sigma * np.random.default_rng(k).standard_normal(range_m.shape)
        grown = (cloud[:, :1] / 2) ** 2 if depth else np.ones((1, 1))
        return np.asarray(cloud * (1 + off * grown / range_m))

    return noisy


def thinned(share: float) -> Callable[[int, Floats], Floats]:
    """Return a function that keeps a random fraction of the points."""
    return lambda k, cloud: cloud[np.random.default_rng(k).random(len(cloud)) < share]


def view(half_rad: float, farthest_m: float = np.inf) -> Callable[[int, Floats], Floats]:
    """Return a function that keeps a sector ahead, up to a range."""

    def seen(_: int, cloud: Floats) -> Floats:
        ahead = np.abs(np.arctan2(cloud[:, 1], cloud[:, 0])) < half_rad
        return np.asarray(cloud[ahead & (np.linalg.norm(cloud, axis=1) < farthest_m)])

    return seen


def around(mid_rad: float, half_rad: float) -> Callable[[int, Floats], Floats]:
    """Return a function that keeps a sector in some direction."""

    def seen(_: int, cloud: Floats) -> Floats:
        off = np.arctan2(cloud[:, 1], cloud[:, 0]) - mid_rad
        return np.asarray(cloud[np.cos(off) > np.cos(half_rad)])

    return seen


def elevated(least_rad: float, most_rad: float) -> Callable[[int, Floats], Floats]:
    """Return a function that keeps a band of elevations."""

    def seen(_: int, cloud: Floats) -> Floats:
        up = np.arctan2(cloud[:, 2], np.hypot(cloud[:, 0], cloud[:, 1]))
        return np.asarray(cloud[(up > least_rad) & (up < most_rad)])

    return seen


def holes(k: int, cloud: Floats) -> Floats:
    """Return a cloud without the points in twelve random cones of 0.2 rad."""
    rng = np.random.default_rng(k)
    ways = cloud / np.maximum(np.linalg.norm(cloud, axis=1, keepdims=True), 1e-12)
    near = ways @ ways[rng.integers(len(ways), size=12)].T >= np.cos(0.2)
    return np.asarray(cloud[~near.any(axis=1)])


def disturbed(name: str, whole: Clouds) -> Iterator[tuple[str, Callable[[], Clouds]]]:
    """Yield a log mirrored, with holes in its clouds, and with half of its scans lost."""
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    flipped = Clouds([cloud * [1, -1, 1] for cloud in whole.points], mirror @ whole.poses @ mirror)
    yield f"{name}/mirrored", lambda: flipped
    yield f"{name}/holes", partial(whole.changed, holes)
    for seed in (1, 2):
        rows = np.flatnonzero(np.random.default_rng(seed).random(len(whole.points)) < 0.5)
        left = Clouds([whole.points[k] for k in rows], whole.poses[rows])
        yield f"{name}/half-lost-{seed}", partial(left.only, slice(None))
