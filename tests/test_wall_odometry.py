"""Odometry among walls: it bridges, narrows the search, connects poses, and may be rejected."""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.core.odometry import OdometryUse
from relmap.datasets.scans import SensorView
from relmap.evaluation.feeding import segment_scan, segmenter_for
from relmap.simulation import simulate_building
from relmap.simulation.odometry import Wheels, wheel_odometry
from tests.worlds import ate_m, turn

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
    assert mapper.odometry is not None
    return mapper.odometry


def assert_as_long_as_wheels_tell(mapper: PlaneMapper, poses: Array) -> None:
    hanging = len(use_of(mapper).hanging)
    # By chance, and as the scale is known no better than by the noise of the other steps.
    noise_m = 0.01 * 0.25 * np.sqrt(hanging + hanging**2 / (len(poses) - hanging))
    ways = (path[-1, :2, 3] - path[14, :2, 3] for path in (mapper.trajectory, poses))
    found_m, true_m = (float(np.linalg.norm(way)) for way in ways)
    assert abs(found_m - true_m) < 3 * noise_m


@cache
def mapped_with_wheels() -> PlaneMapper:
    """Return the refined map of the corridor, which no test changes."""
    poses, scans = in_the_corridor()
    mapper = mapped(scans, odometry_of(poses))
    mapper.refine()
    return mapper


def test_a_bare_corridor_is_one_submap_and_as_long_as_wheels_tell() -> None:
    poses, scans = in_the_corridor()
    assert len(mapped(scans).submaps) > 1
    mapper = mapped_with_wheels()
    (submap,) = mapper.submaps
    assert submap.refined
    bare = [k for k, pose in enumerate(poses) if 8 < pose[0, 3] < 30]
    assert set(bare) <= set(use_of(mapper).hanging.tolist())
    assert not set(range(2, 14)) & set(use_of(mapper).hanging.tolist())
    assert_as_long_as_wheels_tell(mapper, poses)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_long_corridor_with_bays_stays_whole(seed: int) -> None:
    bays = (np.add(BAY, [x, 0]) for x in (55, 40, 20, 5, 1))
    corners = np.concatenate([[[0, -1.3], [60, -1.3], [60, 1.3]], *bays, [[0, 1.3]]])
    poses = np.array([pose_of(x, 0, 0) for x in np.arange(0.5, 58, 0.25)])
    odometry = wheel_odometry(poses, LASER_WHEELS, np.random.default_rng(seed))
    mapper = mapped(scans_from(corners, poses, seed), odometry)
    # No motion is moved far from odometry where beams tell little.
    motions = np.diff(mapper.trajectory[:, :2, 3], axis=0)
    assert_allclose(np.linalg.norm(motions, axis=1), 0.25, atol=0.15)
    mapper.refine()
    assert [submap.refined for submap in mapper.submaps] == [True]
    assert_as_long_as_wheels_tell(mapper, poses)


def test_covariances_reflect_the_noise_of_wheels() -> None:
    mapper = mapped_with_wheels()
    covariances = mapper.map.covariances
    far = mapper.map.positions[:, 0] > 36
    assert far.any()
    assert (~far).any()
    sd_m = np.sqrt(covariances[:, 0, 0])
    assert np.median(sd_m[~far]) < 0.02 < np.median(sd_m[far]) < 0.3


def test_the_noise_and_constant_errors_of_wheels_are_found() -> None:
    poses = round_the_room(200)
    noise = use_of(mapped(scans_from(ROOM, poses), odometry_of(poses))).noise
    assert_allclose(noise.scale, 1 / 1.02, atol=0.01)


def test_scans_without_walls_are_bridged() -> None:
    poses = round_the_room()
    scans = scans_from(ROOM, poses)
    nothing = SimpleNamespace(ends=np.empty((0, 2, 2)), end_type=np.empty((0, 2), dtype=str))
    for k in range(30, 40):
        scans[k] = nothing, np.empty((0, 2))
    assert len(mapped(scans).submaps) > 1
    mapper = mapped(scans, odometry_of(poses))
    mapper.refine()
    assert len(mapper.submaps) == 1
    assert use_of(mapper).hanging.tolist() == list(range(30, 41))
    assert ate_m(mapper.trajectory, poses) < 0.05


def test_where_walls_fix_the_motion_the_map_is_the_same() -> None:
    poses = round_the_room()
    scans = scans_from(ROOM, poses)
    found = []
    for odometry in (None, odometry_of(poses)):
        mapper = mapped(scans, odometry)
        mapper.refine()
        assert len(mapper.submaps) == 1
        found.append(ate_m(mapper.trajectory, poses))
        if odometry is not None:
            assert len(use_of(mapper).hanging) == 0
    assert found[1] == pytest.approx(found[0], abs=0.003)


def test_unknown_odometry_changes_nothing() -> None:
    scans = scans_from(ROOM, round_the_room())
    mappers = [mapped(scans), mapped(scans, np.full((len(scans), 3), np.nan))]
    for mapper in mappers:
        mapper.refine()
    assert_array_equal(mappers[0].trajectory, mappers[1].trajectory)
    assert_array_equal(mappers[0].planes.ends, mappers[1].planes.ends)


def test_runs_with_odometry_are_the_same_again_and_from_saved_states(tmp_path: Path) -> None:
    poses, scans = in_the_corridor()
    odometry = odometry_of(poses)
    mapper = PlaneMapper(journal=tmp_path / "journal.sqlite")
    others = [PlaneMapper()]
    for k, (walls, beams) in enumerate(scans[:90]):
        if k == 45:
            mapper.save(tmp_path / "mapper.npz")
            others.append(PlaneMapper.load(tmp_path / "mapper.npz"))
        for each in (mapper, *others):
            each.update(walls, beams=beams, odometry=odometry[k])
    mapper.close()
    others.append(PlaneMapper.resume(tmp_path / "journal.sqlite"))
    for each in (mapper, *others):
        each.finish()
        each.refine()
    for other in others:
        assert_array_equal(other.trajectory, mapper.trajectory)
        assert_array_equal(other.planes.ends, mapper.planes.ends)
        assert_array_equal(use_of(other).hanging, use_of(mapper).hanging)
        other.close()


def slipped(odometry: Array) -> Array:
    slips = np.random.default_rng(0).random(len(odometry)) < 0.1
    return np.where(slips[:, None] & [True, True, False], 2 * odometry, odometry)


def stale(odometry: Array) -> Array:
    return np.concatenate([odometry[:3], odometry[1:-2]])


@pytest.mark.parametrize("spoil", [slipped, lambda odometry: -odometry, stale])
def test_wrong_odometry_is_left_out_and_named(spoil: Any) -> None:
    run = simulate_building(241, 0.01, sampling="laser", seed=3, iterations=60, step_m=0.3)
    poses, segmenter = run.trajectory, segmenter_for(VIEW)
    points = [scan.points[:, :2] for scan in run.scans]
    scans = [(segment_scan(segmenter, each, VIEW), each) for each in points]
    plain, other = mapped(scans), mapped(scans, spoil(odometry_of(poses)))
    for mapper in (plain, other):
        mapper.refine()
    assert len(other.submaps) == len(plain.submaps) == 1
    before_m, after_m = (ate_m(mapper.trajectory, poses) for mapper in (plain, other))
    assert after_m < 1.2 * before_m
    assert len(use_of(other).left_out) > 2


def bare_part() -> tuple[Array, list[tuple[Any, Array]]]:
    """Return the poses and scans of the first part of the corridor, from the bay on."""
    poses, scans = in_the_corridor()
    return poses[:70], scans[:70]


def dead(odometry: Array) -> Array:
    return np.zeros_like(odometry)


def in_millimetres(odometry: Array) -> Array:
    return odometry * [1000, 1000, 1]


@pytest.mark.parametrize("spoil", [dead, in_millimetres])
def test_wrong_odometry_does_not_bridge_a_corridor(spoil: Any) -> None:
    poses, scans = bare_part()
    plain, other = mapped(scans), mapped(scans, spoil(odometry_of(poses)))
    assert use_of(other).is_wrong
    assert not use_of(other).is_used
    assert_allclose(other.trajectory, plain.trajectory, atol=1e-6)


def test_turns_the_wrong_way_are_noticed() -> None:
    """Where the robot weaves down the corridor, the way is right over a metre."""
    x = np.arange(0.5, 10.5, 0.25)
    poses = np.array([pose_of(at, 0.2 * np.sin(at), 0.3 * np.sin(at)) for at in x])
    use = use_of(mapped(scans_from(CORRIDOR, poses), odometry_of(poses) * [1, 1, -1]))
    assert use.is_wrong
    assert not use.is_used


def test_a_leap_of_odometry_does_not_bridge_a_corridor() -> None:
    poses, scans = bare_part()
    odometry = odometry_of(poses)
    odometry[50, 0] += 60
    mapper = mapped(scans, odometry)
    assert use_of(mapper).left_out.tolist() == [50]
    for submap in mapper.submaps:
        true = poses[slice(*submap.span)]
        assert ate_m(submap.poses, true) < 0.3


def test_a_constant_turn_of_wheels_is_estimated_not_rejected() -> None:
    poses = round_the_room(60)
    odometry = odometry_of(poses)
    odometry[:, 2] -= 0.15 * np.hypot(*odometry[:, :2].T)
    use = use_of(mapped(scans_from(ROOM, poses), odometry))
    assert not use.is_wrong
    assert_allclose(use.noise.turn_per_m[2], 0.15, atol=0.02)


@pytest.mark.parametrize("slip_m", [0.4, 60.0])
def test_a_single_slip_is_named(slip_m: float) -> None:
    poses = round_the_room(60)
    odometry = odometry_of(poses)
    odometry[25, 0] += slip_m
    mapper = mapped(scans_from(ROOM, poses), odometry)
    assert use_of(mapper).left_out.tolist() == [25]
    assert len(mapper.submaps) == 1


def test_a_robot_carried_elsewhere_is_not_bridged() -> None:
    """Wheels count nothing of it, and scans contradict them."""
    poses = round_the_room(60)
    scans = scans_from(ROOM, poses[:30]) + scans_from(HALL, poses[30:])
    mapper = mapped(scans, odometry_of(poses))
    assert sorted(submap.span for submap in mapper.submaps) == [(0, 30), (30, 60)]
    assert use_of(mapper).left_out.tolist() == [30]


def test_walls_without_beams_are_bridged_too() -> None:
    poses = round_the_room()
    scans: list[tuple[Any, Any]] = [(walls, None) for walls, _ in scans_from(ROOM, poses)]
    for k in range(30, 33):
        walls = scans[k][0]
        one = {name: getattr(walls, name)[:1] for name in ("ends", "noise", "n_points")}
        scans[k] = SimpleNamespace(**one, end_type=np.array([["view", "view"]])), None
    mapper = mapped(scans, odometry_of(poses))
    mapper.refine()
    assert len(mapper.submaps) == 1
    assert len(use_of(mapper).hanging) > 0
    assert ate_m(mapper.trajectory, poses) < 0.05
