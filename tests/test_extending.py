"""Submaps that scans show together are joined as a whole."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.refinement.extending import join_seen_together
from tests.worlds import finished, random_rotation, walk


def split(dimension: int, sigma: float = 0.0, ids: bool = True) -> tuple[PointMapper, Ints, Floats]:
    """Return a map whose second half is another submap, that half, and where it was."""
    road = walk(dimension, seed=3, sigma=sigma)
    scans = [(points, seen) if ids else points for seen, points in road.scans]
    mapper = finished(PointMapper(), scans)
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


def test_most_of_the_landmarks_that_scans_show_must_fit_one_motion() -> None:
    """Of four, three do."""
    mapper, half, before = split(2, sigma=0.02)
    mapper.engine.table.take_off_map(half[4:])
    bent = before[:4].copy()
    bent[1] += [3.0, -2.0]
    mapper.engine.map.place(1, half[:4], bent, np.full(4, 20.0))
    assert not join_seen_together(mapper.engine.map, mapper.engine.rows)
    mapper.engine.map.place(1, half[:4], before[:4], np.full(4, 20.0))
    assert join_seen_together(mapper.engine.map, mapper.engine.rows)


@pytest.mark.parametrize(("off_m", "fits"), [(0.0, True), (0.06, False)])
def test_three_landmarks_join_submaps_only_if_they_fit_closely(off_m: float, fits: bool) -> None:
    """A track that mixes two landmarks may be one of them."""
    mapper, half, before = split(2, sigma=0.02)
    mapper.engine.table.take_off_map(half[3:])
    bent = before[:3].copy()
    bent[1, 0] += off_m
    mapper.engine.map.place(1, half[:3], bent, np.full(3, 20.0))
    assert join_seen_together(mapper.engine.map, mapper.engine.rows) == fits


def test_landmarks_that_only_determine_a_pose_do_not_join_submaps() -> None:
    mapper, half, _ = split(2)
    rows, table = mapper.engine.rows, mapper.engine.table
    both = np.isin(rows.segment, rows.segment[np.isin(rows.landmark, half)])
    others = np.setdiff1d(rows.landmark[both], half)
    table.take_off_map(others[2:])
    assert not join_seen_together(mapper.engine.map, rows)
    assert np.all(table.submap[half] == 1)


def test_a_map_is_refined_again_after_submaps_were_joined() -> None:
    mapper, half, _ = split(2, sigma=0.02, ids=False)
    assert len(mapper.submaps) == 2
    mapper.refine()
    assert len(mapper.submaps) == len(mapper.refined) == 1
    assert np.isin(half, mapper.refined[0].landmarks).all()
