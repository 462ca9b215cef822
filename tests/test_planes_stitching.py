"""Poses that a refined map has far from where the motion leads."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from relmap.planes.links import TORN_M
from relmap.planes.stitching import FEW, without_strays


def straight(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return poses (n, 4, 4) along x, a step of 0.1 m apart, and the motions (n, 3) between."""
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, 0, 3] = 0.1 * np.arange(n)
    return poses, np.tile([0.0, -0.1, 0.0], (n, 1))


@pytest.mark.parametrize("n_off", [1, FEW, FEW + 1])
@pytest.mark.parametrize("off_m", [0.9 * TORN_M, 1.5 * TORN_M])
def test_few_poses_far_from_both_their_neighbours_are_left_out(n_off: int, off_m: float) -> None:
    poses, motions = straight(40)
    poses[20 : 20 + n_off, 1, 3] += off_m
    left = np.isnan(without_strays(poses, motions)[:, 0, 0])
    strays = range(20, 20 + n_off) if n_off <= FEW and off_m > TORN_M else range(0)
    assert np.flatnonzero(left).tolist() == list(strays)


def test_a_pose_that_is_turned_far_is_left_out() -> None:
    poses, motions = straight(40)
    poses[20, :2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    assert np.flatnonzero(np.isnan(without_strays(poses, motions)[:, 0, 0])).tolist() == [20]
