"""What a laser meets that is no wall: clutter before walls."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from relmap.segmentation.scanline.lines import scan_walls
from tests.test_planes_closing import refined_error_m

NOISE_M = 0.01
BEARING = np.deg2rad(np.arange(-60.0, 60.25, 0.5))
RAY = np.column_stack([np.cos(BEARING), np.sin(BEARING)])


def wall_ahead(seed: int = 0) -> NDArray[np.float64]:
    """Return the ranges of beams to a wall straight ahead."""
    noise = np.random.default_rng(seed).normal(0, NOISE_M, len(BEARING))
    return np.asarray(3.0 / np.cos(BEARING) + noise)


@pytest.mark.parametrize("seed", range(5))
def test_clutter_hardly_parts_a_wall(seed: int) -> None:
    """Four beams of clutter in a row part it; taken for what they seem it is in 15 pieces."""
    rng = np.random.default_rng(seed)
    ranges = wall_ahead(seed)
    met = rng.uniform(size=len(ranges)) < 0.2
    met[:6] = met[-6:] = False
    ranges = np.where(met, rng.uniform(0.1, 0.95, len(ranges)) * ranges, ranges)
    mixture, labels = scan_walls(ranges[:, None] * RAY, None)
    assert len(mixture.walls) <= 4
    assert (labels[~met] >= 0).mean() > 0.95
    assert (labels[met] < 0).mean() > 0.95
    assert mixture.sigma == pytest.approx(NOISE_M, rel=0.4)


def test_clutter_does_not_mislead_a_map() -> None:
    """A fifth of the beams meet clutter: taken for walls, it broke maps or put them off by 1 m."""
    assert refined_error_m(step_m=0.1, clutter=0.2, seed=2) < 0.05
