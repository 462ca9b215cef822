"""Covariances of points from the noise of range, bearing and elevation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import RelmapError, range_bearing_covariances


@pytest.mark.parametrize("dimension", [2, 3])
def test_range_and_bearing_become_covariances(dimension: int) -> None:
    rng = np.random.default_rng(0)
    point, sigmas = np.array([3.0, 4.0, 2.0])[:dimension], (0.02, 0.003, 0.005)[:dimension]
    r, yaw = np.linalg.norm(point), np.arctan2(4.0, 3.0)
    pitch = np.arcsin(2 / r) if dimension == 3 else 0.0
    drawn = np.array([r, yaw, pitch]) + rng.normal(size=(200_000, 3)) * [0.02, 0.003, 0.005]
    drawn[:, 2] = 0.0 if dimension == 2 else drawn[:, 2]
    turned = Rotation.from_euler("ZY", np.column_stack([drawn[:, 1], -drawn[:, 2]]))
    points = drawn[:, :1] * turned.apply([1.0, 0.0, 0.0])
    found = range_bearing_covariances(point[None], *sigmas)[0]
    np.testing.assert_allclose(found, np.cov(points[:, :dimension].T), atol=3e-6)


def test_sigmas_that_are_none_are_refused() -> None:
    odd: Any = [("1", 1.0), (1.0, np.ones(2))]
    for sigmas in ((0.0, 1.0), (1.0, np.nan), (1.0, 1.0, -1.0), *odd):
        with pytest.raises(RelmapError, match="must be above 0"):
            range_bearing_covariances(np.ones((1, 3)), *sigmas)
    above = range_bearing_covariances(np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]]), 0.1, 0.01)
    assert (np.linalg.eigvalsh(above) > 0).all()
