"""Planes in space: stairs, whose steps match each other."""

from __future__ import annotations

import numpy as np
import pytest

from relmap.planes3d.hypothesis_kernels import best_ways

RISE_M = 0.18


@pytest.mark.parametrize("rise", [-2, 0, 3])
def test_of_equal_motions_on_stairs_the_one_closest_to_the_prediction_is_first(rise: int) -> None:
    # Two walls, and two treads that match all others but for the ends of the flight.
    shifts = range(-6, 7)
    of = np.array([0, 1, *[2] * len(shifts), *[3] * len(shifts)])
    normal = np.eye(3)[np.minimum(of, 2)]
    off = np.array([0.0, 0.0, *[RISE_M * k for k in shifts] * 2])
    gate, weight, held = np.full(len(of), 0.01), np.full(4, 0.25), np.array([0, 0, RISE_M * rise])
    ways, support = best_ways(normal, off, of, gate, weight, held, (0.15, 0.34), 0.02, 4)
    assert support.min() == 1.0
    np.testing.assert_allclose(ways[0], held, atol=1e-12)
