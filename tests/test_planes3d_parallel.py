"""Parallel faces a step apart, as of a cupboard before a wall: the right placement is taken."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import Plane3dMapper
from relmap.core.arrays import Floats
from relmap.simulation.storey import cast_rays
from tests.worlds import ate_m

WIDTH_M, HEIGHT_M = 2.5, 2.6


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> list[Floats]:
    """Return the faces of a box: a corner and two sides each, (3, 3)."""
    size = np.diag(np.subtract(high, low))
    faces = []
    for axis in range(3):
        sides = np.delete(size, axis, axis=0)
        faces += [np.vstack([corner, sides]) for corner in (low, np.add(low, size[axis]))]
    return faces


def corridor(depth_m: float) -> Floats:
    """Return the faces (f, 3, 3) of a corridor of 20 m, with cupboards at its sides and an end."""
    half = WIDTH_M / 2
    return np.array(
        box((-10.0, -half, 0.0), (10.0, half, HEIGHT_M))
        + box((-10.0, -half, 0.0), (-10.0 + depth_m, -0.25, 2.0))
        + box((-4.0, half - 0.3, 0.0), (-3.0, half, 2.1))
        + box((3.0, -half, 0.0), (4.0, -half + 0.3, 1.6))
    )


def rays_of(columns: int, low_deg: float, high_deg: float) -> Floats:
    """Return the rays (n, 3) of a lidar with 32 rings."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, columns, endpoint=False),
        np.deg2rad(np.linspace(low_deg, high_deg, 32)),
    )
    level = np.cos(elevation)
    rays = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
    return rays.reshape(-1, 3)


def driven(depth_m: float, step_m: float, seed: int) -> tuple[list[Floats], Floats]:
    """Return the clouds of a lidar with 32 rings along the corridor, and its poses."""
    rng, faces = np.random.default_rng(seed), corridor(depth_m)
    rays, scans, poses = rays_of(300, -30.0, 30.0), [], []
    for k, x in enumerate(np.arange(-8.0, 0.0, step_m)):
        pose = np.eye(4)
        tilt = [0.04 * np.sin(k / 4), 0.04 * np.cos(k / 3), 0.05 * np.sin(k / 6)]
        pose[:3, :3] = Rotation.from_euler("xyz", tilt).as_matrix()
        pose[:3, 3] = x, 0.05 * np.sin(k / 5), 1.3 + 0.02 * np.sin(k)
        range_m, _ = cast_rays(pose[:3, 3], rays @ pose[:3, :3].T, faces[:, 0], faces[:, 1:])
        range_m += 0.01 * rng.standard_normal(len(range_m))
        scans.append(rays * range_m[:, None])
        poses.append(pose)
    return scans, np.array(poses)


@pytest.mark.parametrize(("depth_m", "step_m"), [(0.3, 0.34), (0.37, 0.35)])
def test_a_step_as_long_as_a_cupboard_is_deep_is_right(depth_m: float, step_m: float) -> None:
    scans, poses = driven(depth_m, step_m, seed=0)
    mapper = Plane3dMapper()
    for points in scans:
        mapper.update(points)
    mapper.finish()
    assert len(mapper.submaps) == 1
    assert ate_m(mapper.trajectory, poses, planar=False) < 0.02


def cupboards(seed: int) -> Floats:
    """Return the faces (f, 3, 3) of a room with a row of unequal cupboards."""
    rng, faces = np.random.default_rng(seed), box((-3.0, -3.0, 0.0), (3.0, 3.0, HEIGHT_M))
    for y in -2.4 + 0.7 * np.arange(7):
        depth, high = rng.uniform(0.2, 0.9), rng.uniform(0.5, 1.9)
        faces += box((3.0 - depth, y, 0.0), (3.0, y + 0.7, high))
    return np.array(faces)


@pytest.mark.parametrize(("seed", "step_rad"), [(8, 0.12), (8, 0.2), (8, 0.28), (4, 0.12)])
def test_a_row_of_parallel_fronts_does_not_break_a_run(seed: int, step_rad: float) -> None:
    # Fronts, tops and sides match each other in many ways, more than the planes in between.
    rng, mapper, faces = np.random.default_rng(0), Plane3dMapper(), cupboards(seed)
    u, v = np.meshgrid(np.linspace(0.6, -0.6, 160), np.linspace(0.45, -0.45, 120))
    rays = np.stack([np.ones_like(u), u, v], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (3, 1, 1))
    for k, pose in enumerate(poses):
        pose[:3, :3] = Rotation.from_euler("zyx", [step_rad * k - 0.2, 0.15, 0.0]).as_matrix()
        pose[:3, 3] = 0.0, 0.1 * k, 1.5 + 0.05 * k
        range_m, _ = cast_rays(pose[:3, 3], rays @ pose[:3, :3].T, faces[:, 0], faces[:, 1:])
        range_m += 0.003 * rng.standard_normal(len(range_m))
        mapper.update(rays * range_m[:, None])
    assert len(mapper.submaps) == 1
    assert ate_m(mapper.trajectory, poses, False) < 0.01


def store() -> Floats:
    """Return the faces (f, 3, 3) of a hall with four rows of shelves, the lowest near the floor."""
    faces = box((0.0, 0.0, 0.0), (20.0, 14.0, 6.0))
    for y in (2.5, 5.5, 8.5, 11.5):
        for z in (0.15, 1.7, 3.2):
            faces += box((2.0, y - 0.5, z), (16.0, y + 0.5, z + 0.12))
        for x in np.arange(2.0, 16.1, 2.8):
            faces += box((x - 0.04, y - 0.5, 0.0), (x + 0.04, y + 0.5, 4.0))
        for k in range(5):
            x, z = 2.3 + 2.7 * k, (0.27, 1.82)[k % 2]
            faces += box((x, y - 0.4, z), (x + 0.8, y + 0.4, z + 0.4 + 0.1 * k))
    return np.array(faces)


@pytest.mark.parametrize("seed", [2, 5, 7])
def test_the_floor_of_an_aisle_is_not_taken_for_a_shelf_above_it(seed: int) -> None:
    rng, faces, rays = np.random.default_rng(seed), store(), rays_of(450, -25.0, 15.0)
    mapper, poses, tilt, x = Plane3dMapper(), list[Floats](), np.zeros(2), 1.0
    for _ in range(16):
        tilt = 0.6 * tilt + 0.8 * rng.normal(0.0, 0.08, 2)
        pose = np.eye(4)
        turn = [*tilt, 0.3 * np.sin(1.1 * x)]
        pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", turn).as_matrix(), (x, 1.1, 1.7)
        range_m, _ = cast_rays(pose[:3, 3], rays @ pose[:3, :3].T, faces[:, 0], faces[:, 1:])
        range_m += 0.02 * rng.standard_normal(len(range_m))
        mapper.update(rays * range_m[:, None])
        poses.append(pose)
        x += rng.uniform(0.2, 0.7)
    assert len(mapper.submaps) == 1
    assert ate_m(mapper.trajectory, np.array(poses), planar=False) < 0.005
