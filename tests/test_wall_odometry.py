"""Odometry among walls: it bridges, narrows the search, and connects poses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from relmap import PlaneMapper
from relmap.planes.linking.registration import PlaneRegistration
from relmap.planes.submaps.doubtful import undetermined_steps
from relmap.simulation.odometry import wheel_odometry
from tests.drives import (
    BAY,
    LASER_WHEELS,
    ROOM,
    Array,
    in_the_corridor,
    mapped,
    odometry_of,
    pose_of,
    round_the_room,
    scans_from,
    use_of,
)
from tests.worlds import ate_m


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


@pytest.mark.parametrize(("off_m", "listed"), [(0.1, []), (0.4, [5])])
def test_a_step_that_contradicts_odometry_is_listed(off_m: float, listed: list[int]) -> None:
    """Walls in view of both scans may be matched wrongly, as doors that look alike."""
    mapper = mapped_with_wheels()
    assert 5 not in mapper.weak_links
    registration, (submap,) = mapper.engine.association.registration, mapper.submaps
    assert isinstance(registration, PlaneRegistration)
    poses = submap.poses.copy()
    poses[5:, 0, 3] += off_m
    weak = undetermined_steps([replace(submap, poses=poses)], mapper.history, registration.links)
    assert np.setdiff1d(weak, mapper.weak_links).tolist() == listed


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


@pytest.mark.parametrize("panel", [False, True])
def test_walls_without_beams_are_bridged_too(panel: bool) -> None:
    poses = round_the_room()
    scans: list[tuple[Any, Any]] = [(walls, None) for walls, _ in scans_from(ROOM, poses)]
    for k in range(30, 33):  # one wall of the room, or a panel that no other scan shows
        walls = scans[k][0]
        one = {name: getattr(walls, name)[:1] for name in ("ends", "noise", "n_points")}
        if panel:
            one["ends"] = np.array([[[1.0, -0.2], [1.0, 1.0]]])
        scans[k] = SimpleNamespace(**one, end_type=np.array([["view", "view"]])), None
    mapper = mapped(scans, odometry_of(poses))
    mapper.refine()
    assert len(mapper.submaps) == 1
    assert len(use_of(mapper).hanging) > 0
    assert ate_m(mapper.trajectory, poses) < 0.05
