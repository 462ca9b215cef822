"""Wrong odometry among walls: rejected as a whole, or where it slips, and named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from relmap.evaluation.feeding import segment_scan, segmenter_for
from relmap.simulation import simulate_building
from tests.drives import (
    CORRIDOR,
    HALL,
    ROOM,
    VIEW,
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
    assert after_m < max(1.2 * before_m, 0.01)  # or the noise of a range
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
