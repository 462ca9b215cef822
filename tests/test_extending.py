"""Submaps that scans show together are joined as a whole."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.refinement.extending import join_seen_together
from tests.worlds import finished, random_rotation, walk


def split(dimension: int, sigma: float = 0.0) -> tuple[PointMapper, Ints, Floats]:
    """Return a map whose second half is another submap, that half, and where it was."""
    road = walk(dimension, seed=3, sigma=sigma)
    mapper = finished(PointMapper(), [(points, ids) for ids, points in road.scans])
    table, global_map = mapper.engine.table, mapper.engine.map
    half = np.flatnonzero(table.submap == 0)
    half = half[table.first[half] > 60]
    before = table.position[half].copy()
    turned = before @ random_rotation(dimension, 2.0, np.random.default_rng(5)).T
    global_map.place(global_map.new_submap(), half, turned + 9.0, np.full(len(half), 20.0))
    return mapper, half, before


@pytest.mark.parametrize("dimension", [2, 3])
def test_submaps_that_scans_show_together_are_joined(dimension: int) -> None:
    mapper, half, before = split(dimension)
    table = mapper.engine.table
    assert len(half) > dimension + 1
    assert np.all(table.submap[half] == 1)
    assert join_seen_together(mapper.engine.map, mapper.engine.rows)
    assert np.all(table.submap[table.submap >= 0] == 0)
    np.testing.assert_allclose(table.position[half], before, atol=1e-6)
    assert not join_seen_together(mapper.engine.map, mapper.engine.rows)


def test_submaps_of_other_shapes_than_scans_show_are_not_joined() -> None:
    mapper, half, before = split(2, sigma=0.02)
    bent = before + np.random.default_rng(1).normal(0, 3.0, before.shape)
    mapper.engine.map.place(1, half, bent, np.full(len(half), 20.0))
    assert not join_seen_together(mapper.engine.map, mapper.engine.rows)
    assert np.all(mapper.engine.table.submap[half] == 1)


def test_submaps_never_seen_together_are_not_joined() -> None:
    mapper, half, _ = split(2)
    rows = mapper.engine.rows
    both = np.isin(rows.segment, rows.segment[np.isin(rows.landmark, half)])
    mapper.engine.table.take_off_map(np.setdiff1d(rows.landmark[both], half))
    assert len(np.unique(mapper.engine.table.submap)) == 3
    assert not join_seen_together(mapper.engine.map, mapper.engine.rows)
