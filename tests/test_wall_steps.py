"""Odometry among walls: lengths of steps, constant errors of wheels, factors of motions."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from relmap.core.odometry import checked_odometry
from relmap.core.refinement.schur import Linearised
from relmap.planes.linking.judging import NO_MATCH, Found
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.motions import from_matrices
from relmap.planes.odometry.prediction import Wheels
from relmap.planes.odometry.steps import MotionFactors, Steps, constant_errors
from relmap.planes.scans.beams import GivenBeams
from tests.drives import odometry_of, round_the_room
from tests.tables import poses_along


def test_motions_that_depend_on_odometry_get_its_final_length() -> None:
    motions, hanging = np.tile([0.1, -0.2, 0.02], (4, 1)), np.array([False, True, True, False])
    motion = np.tile([0.0, 0.25, 0.0], (4, 1))
    motion[2] = np.nan  # unknown odometry
    found = Steps(motion, np.ones((4, 2)), hanging, hanging).lengthened(motions)
    assert_array_equal(found[[0, 2, 3]], motions[[0, 2, 3]])
    assert_allclose(found[1], [0.1, *(0.25 * motions[1, 1:] / np.hypot(0.2, 0.02))])


def test_jitter_of_poses_does_not_bias_the_scale_of_wheels() -> None:
    rng = np.random.default_rng(0)
    poses = poses_along(np.arange(0, 40, 0.1))
    measured = np.linalg.inv(poses[:-1]) @ poses[1:]
    poses[:, :2, 3] += 0.03 * rng.normal(size=(len(poses), 2))
    steps = np.linalg.inv(poses[:-1]) @ poses[1:]
    found = constant_errors(steps, measured)
    assert_allclose(found.scale, 1, atol=0.01)
    assert constant_errors(steps[:100], measured[:100]) is None


def test_factors_have_the_derivatives_of_their_residuals() -> None:
    rng = np.random.default_rng(0)
    factors = MotionFactors(np.array([[0, 1], [1, 3]]), rng.normal(size=(2, 3)), np.ones((2, 2)))
    none = Linearised(np.empty(0), np.empty((0, 3)), np.empty((0, 2)))
    yaw, t = rng.normal(size=4), rng.normal(size=(4, 2))
    found = factors.added_to(none, yaw, t)
    for i in range(4):
        for k in range(3):
            step = np.zeros((4, 3))
            step[i, k] = 1e-6
            moved = factors.added_to(none, yaw + step[:, 0], t + step[:, 1:])
            # Where both poses meet stays where it was, and is in the middle of the new ones.
            change = (moved.off - found.off) / 1e-6
            own = np.where(factors.iteration == i, found.by_eliminated[:, k], 0.0)
            middle = own.reshape(2, -1).sum(axis=0) / 2
            assert_allclose(change, own - np.tile(middle, 2), atol=1e-5)


def test_the_noise_of_wheels_is_estimated_anew_once_submaps_are_joined() -> None:
    poses, record, motions = round_the_room(40), LinkRecord(1.0), np.zeros((40, 3))
    none: Any = SimpleNamespace(beams=GivenBeams.checked(np.empty((0, 2)), np.zeros(2)))
    motions[1:] = from_matrices(np.linalg.inv(poses[1:]) @ poses[:-1])
    motions[20] = 0.0
    for k, step in enumerate(odometry_of(poses)):
        if k % 20 == 0:
            record.begin_submap()
        record.append(none, motions[k], True, Found(motions[k], NO_MATCH, k != 20, 0.0), True)
        record.wheels.given.append(checked_odometry(step), k)
    before = record.wheels.noise(record.motions, record.measured)
    record.join([poses], np.empty((0, 2), dtype=np.int64))
    found, fresh = record.wheels.noise(record.motions, record.measured), Wheels()
    fresh.given = record.wheels.given
    again = fresh.noise(record.motions, record.measured)
    assert found.sigma_way == again.sigma_way != before.sigma_way
