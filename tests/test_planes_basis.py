"""The consistent basis of corners and midpoints (Figs 1, 2)."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats
from relmap.planes.linking.registration import PlaneRegistration
from relmap.planes.model import WallModel
from tests.worlds import aligned_rmse, random_rotation

MODEL = WallModel(PlaneRegistration(max_missed=5, bridge_m=1.0))
CORNERS = np.array([[4.0, 2.0], [4.0, 0.0], [-1.0, 2.0], [1.5, 2.0]])


def block() -> Floats:
    """Return the corners as seen in nine iterations."""
    rng = np.random.default_rng(0)
    views = [CORNERS @ random_rotation(2, 3.0, rng).T + rng.uniform(-3, 3, 2) for _ in range(9)]
    return np.swapaxes(np.array(views), 0, 1)


def test_a_relative_map_is_exact_without_noise() -> None:
    relative = MODEL.average_in_basis(block())
    assert aligned_rmse(relative, CORNERS) < 1e-12


def test_an_iteration_in_which_the_basis_falls_together_does_not_count() -> None:
    seen = block()
    seen[:, 2] = seen[:1, 2]
    relative = MODEL.average_in_basis(seen)
    assert aligned_rmse(relative, CORNERS) < 1e-12


def test_one_place_determines_no_basis() -> None:
    assert MODEL.average_in_basis(np.ones((3, 9, 2))) is None
