"""The estimated errors of odometry, against known errors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from relmap import PointMapper
from relmap.core.arrays import Floats
from relmap.core.motion_noise import MotionNoise, leaps, missing_turn, motion_noise
from relmap.core.odometry import checked_odometry

Array = Floats
SLIPS = 0.1


def drive(rng: np.random.Generator) -> Array:
    steps = zip(rng.uniform(0.5, 0.7, 300), rng.normal(0, 0.1, 300), strict=True)
    return np.array([checked_odometry([x, 0.02, yaw]) for x, yaw in steps])


def odometry_of(true: Array, rng: np.random.Generator, way: float, yaw: float) -> Array:
    """Return odometry 3 % short, that misses 0.02 rad on each metre, with noise."""
    found = []
    for motion in true:
        t, turn = motion[:2, 3], np.arctan2(motion[1, 0], motion[0, 0])
        length = np.linalg.norm(t)
        off = way * length * rng.normal(size=2)
        turn += yaw * rng.normal() - 0.02 * length / 1.03
        found.append(checked_odometry([*(t / 1.03 + off), turn]))
    return np.array(found)


@pytest.mark.parametrize("seed", range(5))
def test_constant_errors_and_noise_are_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = drive(rng)
    found = motion_noise(odometry_of(true, rng, way=0.01, yaw=0.002), true)
    assert not found.is_wrong
    assert_allclose(found.scale, 1.03, atol=0.003)
    assert_allclose(found.turn_per_m, [0, 0, 0.02], atol=0.001)
    assert_allclose([found.sigma_way, found.sigma_rad], [0.01, 0.002], rtol=0.25)


@pytest.mark.parametrize("seed", range(5))
def test_slipping_steps_are_detected_and_harmless(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = drive(rng)
    odometry = odometry_of(true, rng, way=0.01, yaw=0.002)
    slips = rng.random(len(true)) < SLIPS
    odometry[slips, :2, 3] *= 2
    found = motion_noise(odometry, true)
    assert not found.is_wrong
    assert_allclose(found.scale, 1.03, atol=0.01)
    assert (found.slipped(odometry, true) == slips).all()


def reversed_sign(odometry: Array) -> Array:
    odometry[:, :2, 3] *= -1
    return odometry


@pytest.mark.parametrize("spoil", [reversed_sign, lambda odometry: odometry[::-1]])
def test_odometry_of_another_robot_is_detected(spoil: Callable[[Array], Array]) -> None:
    rng = np.random.default_rng(0)
    true = drive(rng)
    true[::2, :2, 3] *= 0.05  # so that another step is another motion
    found = motion_noise(spoil(odometry_of(true, rng, way=0.01, yaw=0.002)), true)
    assert found.is_wrong


def test_without_enough_odometry_there_is_no_estimate() -> None:
    true = drive(np.random.default_rng(0))
    assert motion_noise(np.full_like(true, np.nan), true) is None
    assert motion_noise(true[:7], true[:7]) is None


def test_a_robot_that_stands_still_has_exact_odometry() -> None:
    still = np.tile(np.eye(4), (20, 1, 1))
    found = motion_noise(still, still)
    assert not found.is_wrong
    assert found.sigma_m <= 1e-3
    assert found.sigma_rad <= 1e-3


def test_driving_after_a_long_stop_does_not_leap() -> None:
    rng = np.random.default_rng(0)
    true = np.concatenate([np.tile(np.eye(4), (5000, 1, 1)), drive(rng)])
    odometry = odometry_of(true, rng, way=0.01, yaw=0.002)
    assert not leaps(odometry, np.ones(len(odometry), dtype=bool)).any()
    found = motion_noise(odometry, true)
    assert_allclose(found.scale, 1.03, atol=0.003)


def test_only_what_is_far_longer_than_most_steps_is_a_leap() -> None:
    odometry = odometry_of(drive(np.random.default_rng(0)), np.random.default_rng(1), 0.01, 0.002)
    odometry[[7, 9], 0, 3] = 5.0, 10.0
    known = np.ones(len(odometry), dtype=bool)
    assert np.flatnonzero(leaps(odometry, known)).tolist() == [9]
    assert not leaps(odometry[:3], known[:3]).any()


@pytest.mark.parametrize(
    ("counted", "is_missed"), [(0.0, True), (-0.4, True), (1.0, True), (0.25, False), (0.5, False)]
)
def test_a_turn_is_missed_if_odometry_is_off_by_more_than_half(
    counted: float, is_missed: bool
) -> None:
    odometry, true = (checked_odometry([0.1, 0, yaw])[None] for yaw in (counted, 0.4))
    judged, missed = missing_turn(odometry, true, np.array([0.01]))
    assert judged.tolist() == [True]
    assert missed.tolist() == [is_missed]


def test_noise_about_other_axes_does_not_count_as_a_missed_turn() -> None:
    true, odometry = np.eye(4)[None].copy(), np.eye(4)[None].copy()
    true[0, :3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.05]).as_matrix()
    odometry[0, :3, :3] = Rotation.from_rotvec([0.04, 0.0, 0.045]).as_matrix()
    judged, missed = missing_turn(odometry, true, np.array([0.001]))
    assert judged.tolist() == [True]
    assert missed.tolist() == [False]


def test_a_turn_larger_than_those_compared_is_less_certain() -> None:
    rng = np.random.default_rng(0)
    true = drive(rng)
    found = motion_noise(odometry_of(true, rng, way=0.01, yaw=0.002), true)
    turns = np.array([checked_odometry([0.6, 0.0, yaw]) for yaw in (0.0, 0.1, 3.1)])
    _, sigma_rad = found.sigmas(turns)
    assert_allclose(sigma_rad[:2], found.sigma_rad)
    assert_allclose(sigma_rad[2], found.sigma_rad * 3.1 / found.turn_rad)
    assert sigma_rad[2] > 10 * found.sigma_rad
    loose = MotionNoise(sigma_rad=0.05, turn_rad=0.1)
    assert_allclose(loose.sigmas(turns)[1], [0.05, 0.05, 0.05 * 3.1])


@pytest.mark.parametrize("seed", [0, 1])
def test_landmarks_nearly_on_a_line_in_space_do_not_show_slips(seed: int) -> None:
    rng, mapper, before = np.random.default_rng(seed), PointMapper(), np.eye(4)
    across = 0.3 * rng.normal(size=(34, 2)) + [2.0, 1.0]
    lamps = np.column_stack([np.arange(-5, 45, 1.5), across])
    for k in range(160):
        tilt = [0.2 * np.sin(k / 9), 0.1 * np.sin(k / 7), 0.1 * np.cos(k / 11)]
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("ZYX", tilt).as_matrix()
        T[:3, 3] = 0.25 * k, 0.0, 0.3 * np.sin(k / 15)
        local = (lamps - T[:3, 3]) @ T[:3, :3]
        own = np.flatnonzero((np.linalg.norm(local, axis=1) < 5) & (rng.random(34) > 0.1))
        own = own[:1] if 70 < k < 76 else own
        motion, before = np.linalg.inv(before) @ T, T
        motion[:3, 3] += 0.02 * np.linalg.norm(motion[:3, 3]) * rng.normal(size=3)
        motion[:3, :3] @= Rotation.from_rotvec(0.004 * rng.normal(size=3)).as_matrix()
        mapper.update(local[own] + 0.03 * rng.normal(size=(len(own), 3)), own, odometry=motion)
    mapper.finish()
    mapper.refine()
    assert mapper.odometry.is_used
    assert not len(mapper.odometry.left_out)
