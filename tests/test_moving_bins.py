"""Landmarks that move together, as parts of a vehicle, are distinguished from single ones."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Ints
from relmap.core.grouping.dynamics import DynamicStatus
from relmap.core.landmarks import LandmarkTable
from relmap.core.state.table import NONE, LandmarkState
from tests.worlds import random_rotation

both_dimensions = pytest.mark.parametrize("d", [2, 3])
SIGMA = 0.05
REST, PARTS, SOLOISTS = 20, 4, 3


def driven(d: int, vehicles: int, seed: int, iterations: int = 120) -> LandmarkTable:
    """Map landmarks at rest, vehicles of four reflectors each, and soloists that go apart fast."""
    rng, mapper = np.random.default_rng(seed), PointMapper()
    rest = rng.uniform(-10, 10, (REST, d))
    corners = rng.uniform(-1.5, 1.5, (vehicles, PARTS, d)) + rng.uniform(-5, 5, (vehicles, 1, d))
    turns = 2 * np.pi * np.arange(vehicles + SOLOISTS) / (vehicles + SOLOISTS)
    ways = np.zeros((vehicles + SOLOISTS, d))
    ways[:, :2] = np.column_stack([np.cos(turns), np.sin(turns)])
    for k in range(iterations):
        parts = (corners + 0.15 * k * ways[:vehicles, None]).reshape(-1, d)
        alone = (3 + 0.3 * k) * ways[vehicles:]
        world = np.vstack([rest, parts, alone])
        R, t = random_rotation(d, 0.2, rng), rng.uniform(-1, 1, d)
        noise = SIGMA * rng.standard_normal(world.shape)
        mapper.update((world - t) @ R + noise, np.arange(len(world)))
    mapper.finish()
    return mapper.landmarks


@both_dimensions
@pytest.mark.parametrize("vehicles", [0, 1, 2])
def test_vehicles_are_bins_and_soloists_are_in_none(d: int, vehicles: int) -> None:
    for seed in range(5):
        table = driven(d, vehicles, seed)
        moving = np.arange(len(table.landmark)) >= REST
        np.testing.assert_array_equal(table.status == "dynamic", moving)
        vehicle = (np.arange(vehicles * PARTS) // PARTS) * PARTS + REST
        expected = [*[NONE] * REST, *vehicle.tolist(), *[NONE] * SOLOISTS]
        assert table.moving_bin.tolist() == expected


def remembered(n: int) -> DynamicStatus:
    table = LandmarkState()
    table.resize(n, 0, 2)
    return DynamicStatus(table)


def together(status: DynamicStatus) -> list[list[int]]:
    bins = status.table.moving_bin
    return [np.flatnonzero(bins == number).tolist() for number in np.unique(bins[bins != NONE])]


def bins_of(*bins: list[int]) -> list[Ints]:
    return [np.array(members) for members in bins]


NOBODY = np.empty(0, dtype=np.int64)


def test_a_bin_keeps_its_number_while_some_of_it_stay_together() -> None:
    status = remembered(8)
    status.go_together(bins_of([1, 2, 3], [5, 6]), NOBODY)
    before = status.table.moving_bin.copy()
    status.go_together(bins_of([2, 3, 4]), NOBODY)  # 1 is out of sight
    assert together(status) == [[1, 2, 3, 4], [5, 6]]
    assert (status.table.moving_bin[[1, 5]] == before[[1, 5]]).all()


def test_a_landmark_that_moves_differently_leaves_its_bin() -> None:
    status = remembered(8)
    status.go_together(bins_of([1, 2, 3]), NOBODY)
    status.go_together(bins_of([2, 3]), np.array([1]))
    assert together(status) == [[2, 3]]


def test_one_seen_without_its_company_keeps_its_bin() -> None:
    status = remembered(8)
    status.go_together(bins_of([1, 2, 3]), NOBODY)
    status.go_together([], np.array([1]))
    assert together(status) == [[1, 2, 3]]


def test_a_bin_that_falls_apart_is_two() -> None:
    status = remembered(8)
    status.go_together(bins_of([1, 2, 3, 4]), NOBODY)
    status.go_together(bins_of([1, 2], [3, 4]), NOBODY)
    assert together(status) == [[1, 2], [3, 4]]


def test_one_that_changes_over_does_not_take_the_name_of_its_old_bin_along() -> None:
    status = remembered(8)
    status.go_together(bins_of([1, 2, 3]), NOBODY)
    status.go_together(bins_of([2, 3]), np.array([1]))
    status.go_together(bins_of([1, 7]), NOBODY)  # the others are out of sight
    assert together(status) == [[2, 3], [1, 7]]
