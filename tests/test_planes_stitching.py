"""Poses of a refined map that deviate from the motions."""

from __future__ import annotations

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.planes.submaps.submap import ASTRAY_M, FEW, with_strays_put_back
from tests.tables import poses_along


def straight(n: int) -> tuple[Floats, Floats]:
    """Return poses (n, 4, 4) along x, a step of 0.1 m apart, and the motions (n, 3) between."""
    return poses_along(0.1 * np.arange(n)), np.tile([0.0, -0.1, 0.0], (n, 1))


@pytest.mark.parametrize("n_off", [1, FEW, FEW + 1])
@pytest.mark.parametrize("off_m", [0.9 * ASTRAY_M, 1.5 * ASTRAY_M])
@pytest.mark.parametrize("begin", [0, 20, 30])
def test_few_poses_off_both_their_neighbours_are_put_back(
    n_off: int, off_m: float, begin: int
) -> None:
    true, motions = straight(30 + n_off)
    poses = true.copy()
    poses[begin : begin + n_off, 1, 3] += off_m
    found = with_strays_put_back(poses, motions)
    put_back = n_off <= FEW and off_m > ASTRAY_M
    np.testing.assert_allclose(found, true if put_back else poses, atol=1e-12)


def test_a_pose_that_is_turned_far_is_put_back() -> None:
    poses, motions = straight(40)
    poses[20, :2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    np.testing.assert_allclose(with_strays_put_back(poses, motions), straight(40)[0], atol=1e-12)


def test_poses_at_a_tear_stay_where_they_are() -> None:
    poses, motions = straight(40)
    poses[20:, 0, 3] += 0.7
    poses[21:, 0, 3] += 0.7
    np.testing.assert_array_equal(with_strays_put_back(poses, motions), poses)
