"""A map says how far off it is expected to be, and which gaps make it so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap import PointMapper
from relmap.cli.outcome import hanging_together
from relmap.core.refinement.hinges import DOMINANT, Hinges
from relmap.simulation import WorldSpec
from tests.worlds import mapped_world


def hinges(mapper: PointMapper) -> Hinges:
    found = mapper.engine.hinges
    assert found is not None
    return found


@pytest.mark.parametrize("kind", ["streets", "ring", "line"])
@pytest.mark.parametrize("space", [False, True])
def test_maps_without_gaps_are_as_far_off_as_expected(kind: str, space: bool) -> None:
    spec = WorldSpec(kind=kind, length_m=200.0, iterations=160, space=space, seed=3)
    mapper, rmse_m = mapped_world(spec)
    assert 0.5 < rmse_m / hinges(mapper).expected_error_m < 2
    assert hinges(mapper).share < 0.2


@pytest.mark.parametrize("seed", [10, 53])
def test_maps_that_few_landmarks_hold_together_are_expected_to_be_off(seed: int) -> None:
    """They are 4 to 6 times as far off as least squares with the true ids."""
    mapper, rmse_m = mapped_world(WorldSpec(spacing_m=7.0, seed=seed))
    found = hinges(mapper)
    assert 0.07 < rmse_m < 2 * found.expected_error_m
    assert found.share > DOMINANT
    assert found.share >= found.shares.max() > 0.5


def test_they_are_part_of_the_state(tmp_path: Path) -> None:
    mapper, _ = mapped_world(WorldSpec(spacing_m=7.0, seed=11))
    mapper.save(tmp_path / "mapper.npz")
    loaded = PointMapper.load(tmp_path / "mapper.npz")
    np.testing.assert_array_equal(hinges(loaded).shares, hinges(mapper).shares)
    loaded.update(np.zeros((1, 2)))
    assert loaded.engine.hinges is None


def test_the_closing_line_says_where_the_map_may_bend() -> None:
    hinges = {"share": 0.9, "steps": [[3, 8], [20, 21]], "shares": [0.7, 0.3]}
    said = hanging_together({"expected_error_m": 0.456, "hinges": hinges})
    assert "expected error of the map: 0.46 m" in said
    assert "into iterations 8, 21" in said
    assert not hanging_together({"expected_error_m": 0.456, "hinges": hinges | {"share": 0.7}})
    assert not hanging_together({"expected_error_m": None, "hinges": None})
