"""Landmarks that move slowly together bend the map, which is said."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from relmap import PointMapper
from relmap.cli.warned import crept
from relmap.core.readout import creep
from tests.worlds import turn

SIGMA_M, RADIUS_M, STEP_RAD = 0.05, 40.0, 0.02


@cache
def circled(speed_m: float, longer: float = 1.0, seed: int = 0) -> PointMapper:
    """Map landmarks round which a robot circles, a third of which move together, metres a scan.

    Ranges are measured too long by a factor `longer`.
    """
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-60, 60, (700, 2))
    moving = rng.random(len(landmarks)) < 0.35
    mapper = PointMapper()
    for k in range(330):
        here = landmarks + moving[:, None] * speed_m * k * np.array([0.6, 0.8])
        at = RADIUS_M * np.array([np.sin(STEP_RAD * k), 1 - np.cos(STEP_RAD * k)])
        local = (here - at) @ turn(STEP_RAD * k)
        seen = (np.linalg.norm(local, axis=1) < 20) & (local[:, 0] > -5)
        points = longer * local[seen] + rng.normal(0, SIGMA_M, (seen.sum(), 2))
        mapper.update(points, np.flatnonzero(seen))
    mapper.finish()
    mapper.refine()
    return mapper


def test_slow_motion_together_gives_a_warning() -> None:
    creep_m = creep(circled(0.01).engine)
    assert creep_m is not None
    assert 0.001 < creep_m < 0.01
    assert f"move by about {creep_m:.1g} m per iteration" in crept(creep_m)


@pytest.mark.parametrize("longer", [1.0, 1.01])
def test_landmarks_at_rest_give_none_even_if_ranges_are_wrong(longer: float) -> None:
    """What is systematically wrong in a range depends on the viewpoint, which goes round."""
    creep_m = creep(circled(0.0, longer).engine)
    assert creep_m == 0
    assert not crept(creep_m)


def test_before_refinement_nothing_is_known() -> None:
    assert creep(PointMapper().engine) is None
    assert not crept(None)
