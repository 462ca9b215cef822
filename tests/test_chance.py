"""Matches that chance explains."""

from __future__ import annotations

import numpy as np
import pytest

from relmap.core.association.chance import Chance
from relmap.core.association.placement import Placement
from relmap.core.association.scale import Scale


@pytest.mark.parametrize(
    ("missed", "n_agreeing", "exceeded"), [(0, 6, True), (1, 6, False), (1, 9, True)]
)
def test_little_motion_is_not_favoured_after_a_scan_that_matched_nothing(
    missed: int, n_agreeing: int, exceeded: bool
) -> None:
    """Six of 24 tracks were matched so by chance, and a map was 11 m off."""
    scale = Scale()
    scale.spacing_m, scale.noise_m = 2.04, 0.0672
    rng = np.random.default_rng(0)
    here, there = rng.uniform(-15, 15, (24, 2)), rng.uniform(-15, 15, (40, 2))
    near = Placement(np.eye(2), np.array([0.9, 0.3]), n_agreeing)
    assert Chance(scale, 0, None).is_exceeded(near, here, there, missed) == exceeded
