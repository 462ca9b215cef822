"""Comparisons of beams: surfaces in one vector, and beams that are looked up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.core.linalg.compiling import compiled
from relmap.planes.scans.beam_kernels import compared
from relmap.planes.scans.beams import Beams, GivenBeams
from relmap.planes.scans.surface_kernels import BESIDE, squared_nearest


@compiled
def nearest(x: float, y: float, lines: Floats, first: int) -> float:
    found: float = squared_nearest(x, y, lines, first)
    return found


def beams_of(bearings_rad: Floats, ranges_m: Floats) -> Any:
    points = ranges_m[:, None] * np.column_stack([np.cos(bearings_rad), np.sin(bearings_rad)])
    given = GivenBeams(points.astype(np.float32), np.zeros(2), True)
    return Beams.of(given, np.array([[[3.0, -2.0], [3.0, 2.0]]])).arrays


def test_the_nearest_of_seven_surfaces_and_gaps() -> None:
    rng, n = np.random.default_rng(0), 30
    lines = rng.normal(size=(6, n))
    lines[4] = np.where(rng.random(n) < 0.3, -1.0, 1 / (lines[2] ** 2 + lines[3] ** 2))
    for first in range(n - 2 * BESIDE - 1):
        x, y = rng.normal(size=2)
        ax, ay, ux, uy, inverse = lines[:5, first : first + 2 * BESIDE + 1]
        t = np.clip(((x - ax) * ux + (y - ay) * uy) * inverse, 0, 1)
        on_it = (x - ax - t * ux) ** 2 + (y - ay - t * uy) ** 2
        begin, end = (x - ax) ** 2 + (y - ay) ** 2, (x - ax - ux) ** 2 + (y - ay - uy) ** 2
        expected = np.where(inverse < 0, np.minimum(begin, end), on_it).min()
        assert nearest(x, y, lines, first) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("view_rad", [np.pi, 2 * np.pi])
def test_spaced_points_are_compared_as_those_alone_would_be(view_rad: float) -> None:
    rng = np.random.default_rng(0)
    bearings = np.linspace(-view_rad / 2, view_rad / 2, 361)[1:]
    earlier, later = (beams_of(bearings, 3 + rng.normal(size=360).cumsum() / 50) for _ in range(2))
    one, other = (
        (points[::3], at, solid[::3], *rest) for points, at, solid, *rest in (earlier, later)
    )
    motions = rng.normal(size=(50, 3))
    sums = compared(earlier, later, motions, 0.12, 3, False)
    np.testing.assert_array_equal(sums, compared(one, other, motions, 0.12, 1, False))
    assert (sums.sum(axis=0) > 0).all()
