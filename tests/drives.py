"""Drives of a laser through a corridor and a room, with odometry, for the tests of walls."""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import numpy as np

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.core.odometry import OdometryUse
from relmap.datasets.scans import SensorView
from relmap.evaluation.feeding import segment_scan, segmenter_for
from relmap.simulation.odometry import Wheels
from tests.worlds import turn

Array = Floats

RANGE_M = 8.0
VIEW = SensorView(np.pi, RANGE_M)
LASER_WHEELS = Wheels(turn_deg=0.0, turn_deg_per_m=0.5, way_bias=0.01, turn_bias_deg_per_m=0.05)
BAY = np.array([[2.0, 1.3], [2.0, 2.0], [0.0, 2.0], [0.0, 1.3]])
CORRIDOR = np.concatenate(
    [[[0, -1.3], [44, -1.3], [44, 1.3]], *(np.add(BAY, [x, 0]) for x in (39, 5, 1)), [[0, 1.3]]]
)
"""A bare corridor with bays at both ends, seen from inside, counter-clockwise."""
ROOM = np.array([[4, -3], [4, 2], [1.5, 2], [1.5, 3.5], [-3, 3.5], [-3, -3]], dtype=np.float64)
HALL = np.array([[2.2, -5], [2.2, 5], [-1.5, 5], [-1.5, -5]])


def cast(corners: Array, pose: Array, rng: np.random.Generator) -> Array:
    """Return where beams of a laser end from a pose (4, 4), with 1 cm of noise; robot frame."""
    bearing = np.linspace(-np.pi / 2, np.pi / 2, 241)
    beam = np.column_stack([np.cos(bearing), np.sin(bearing)])
    u, nearest = beam @ pose[:2, :2].T, np.full(len(beam), np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        across, along = np.array([b[1] - a[1], a[0] - b[0]]), b - a
        with np.errstate(divide="ignore"):
            r = (across @ (a - pose[:2, 3])) / (u @ across)
        s = (
            (pose[:2, 3] + np.where(np.isfinite(r), r, 0)[:, None] * u - a)
            @ along
            / (along @ along)
        )
        nearest = np.where((r > 0) & (s >= 0) & (s <= 1), np.minimum(nearest, r), nearest)
    there = nearest < RANGE_M
    range_m = nearest[there] + rng.normal(0, 0.01, there.sum())
    return np.asarray(range_m[:, None] * beam[there])


def pose_of(x: float, y: float, yaw: float) -> Array:
    T = np.eye(4)
    T[:2, :2], T[:2, 3] = turn(yaw), [x, y]
    return T


def down_the_corridor(step_m: float = 0.25) -> Array:
    return np.array([pose_of(x, 0, 0) for x in np.arange(0.5, 42, step_m)])


def round_the_room(n: int = 60) -> Array:
    """Return poses on a way to and fro in a room, turning."""
    phase = np.linspace(0, 2 * np.pi, n)
    path = np.column_stack([-0.5 + 1.2 * np.cos(phase), -0.5 + 0.8 * np.sin(2 * phase)])
    return np.array(
        [pose_of(at[0], at[1], yaw) for at, yaw in zip(path, np.sin(phase), strict=True)]
    )


def odometry_of(poses: Array, seed: int = 0, scale: float = 1.02) -> Array:
    """Return odometry: 2 % too long, with noise of 1 % and 0.5 degrees per metre."""
    rng, found = np.random.default_rng(seed), [np.full(3, np.nan)]
    for before, after in itertools.pairwise(poses):
        T = np.linalg.inv(before) @ after
        way = np.hypot(*T[:2, 3])
        turn = np.arctan2(T[1, 0], T[0, 0]) + np.deg2rad(0.5) * way * rng.normal()
        found.append(np.array([*(scale * T[:2, 3] + 0.01 * way * rng.normal(size=2)), turn]))
    return np.array(found)


def scans_from(corners: Array, poses: Array, seed: int = 0) -> list[tuple[Any, Array]]:
    """Return the walls and beams of a scan from each pose."""
    rng, segmenter = np.random.default_rng(seed), segmenter_for(VIEW)
    points = [cast(corners, pose, rng) for pose in poses]
    return [(segment_scan(segmenter, each, VIEW), each) for each in points]


@cache
def in_the_corridor() -> tuple[Array, list[tuple[Any, Array]]]:
    """Return the poses down the corridor, and the walls and beams of a scan from each."""
    poses = down_the_corridor()
    return poses, scans_from(CORRIDOR, poses)


def mapped(scans: list[tuple[Any, Array]], odometry: Array | None = None) -> PlaneMapper:
    mapper = PlaneMapper()
    for k, (walls, beams) in enumerate(scans):
        motion = None if odometry is None else odometry[k]
        mapper.update(walls, beams=beams, odometry=motion)
    mapper.finish()
    return mapper


def use_of(mapper: PlaneMapper) -> OdometryUse:
    """Return how odometry was used."""
    return mapper.odometry
