"""Odometry among walls: lengths of steps, constant errors of wheels, factors of motions."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from relmap.core.refinement.schur import Linearised
from relmap.planes.odometry.steps import MotionFactors, Steps, constant_errors
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
