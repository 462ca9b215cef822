"""Objects other than walls: clutter in front of walls, and curves."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PlaneSegmenter
from relmap.core.arrays import Floats
from relmap.segmentation.planes import Planes
from relmap.segmentation.scanline.lines import LaserScan, scan_walls
from tests.test_planes_closing import refined_error_m

NOISE_M = 0.01
BEARING = np.deg2rad(np.arange(-60.0, 60.25, 0.5))
RAY = np.column_stack([np.cos(BEARING), np.sin(BEARING)])


def wall_ahead(seed: int = 0) -> Floats:
    """Return the ranges of beams to a wall straight ahead."""
    noise = np.random.default_rng(seed).normal(0, NOISE_M, len(BEARING))
    return np.asarray(3.0 / np.cos(BEARING) + noise)


@pytest.mark.parametrize("seed", range(5))
def test_clutter_hardly_parts_a_wall(seed: int) -> None:
    """Four consecutive beams of clutter split it; without filtering it is in 15 pieces."""
    rng = np.random.default_rng(seed)
    ranges = wall_ahead(seed)
    met = rng.uniform(size=len(ranges)) < 0.2
    met[:6] = met[-6:] = False
    ranges = np.where(met, rng.uniform(0.1, 0.95, len(ranges)) * ranges, ranges)
    mixture, labels = scan_walls(LaserScan(ranges[:, None] * RAY))
    assert len(mixture.walls) <= 4
    assert (labels[~met] >= 0).mean() > 0.95
    assert (labels[met] < 0).mean() > 0.95
    assert mixture.sigma == pytest.approx(NOISE_M, rel=0.4)


def test_clutter_does_not_break_or_mislead_a_map() -> None:
    """A fifth of the beams meet clutter: taken for walls, it broke maps or put them off by 1 m."""
    assert refined_error_m(step_m=0.2, clutter=0.2, seed=2) < 0.02


def planes_of(ranges: Floats) -> Planes:
    return PlaneSegmenter(view_rad=2.1, range_m=8.0).fit(ranges[:, None] * RAY).planes_


def test_pieces_of_a_curve_hardly_have_corners() -> None:
    """How little they bow is sometimes lost in noise; else all of their ends are corners."""
    inside = -np.cos(BEARING) + np.sqrt(9.0 - np.sin(BEARING) ** 2)  # a round room
    rooms = [
        planes_of(inside + np.random.default_rng(seed).normal(0, NOISE_M, len(BEARING)))
        for seed in range(10)
    ]
    assert min(map(len, rooms)) >= 3
    types = np.concatenate([planes.end_type.ravel() for planes in rooms])
    assert (types == "corner").mean() < 0.2
    assert (types == "occluded").mean() > 0.5


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("turn_deg", [15.0, 25.0, -20.0])
def test_straight_walls_have_a_corner_however_little_they_turn(turn_deg: float, seed: int) -> None:
    turn = np.deg2rad(turn_deg)
    side = 3.0 * np.cos(turn) / np.cos(BEARING + turn)  # the other wall, from straight ahead on
    ranges = np.where(BEARING > 0, side, 3.0 / np.cos(BEARING))
    ranges += np.random.default_rng(seed).normal(0, NOISE_M, len(BEARING))
    planes = planes_of(ranges)
    assert len(planes) == 2
    assert (planes.end_type == "corner").sum() == 2


def test_a_curve_does_not_mislead_a_map() -> None:
    """Taken for corners, the bends between its pieces put maps off by 0.5 to 0.8 m."""
    assert refined_error_m(step_m=0.1, world="curved", seed=2) < 0.05
