from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relmap import PointMapper
from relmap.core.association.reobservation.evidence import chosen
from relmap.core.association.reobservation.merging import Merger
from relmap.core.config import MapperConfig
from relmap.core.geometry.spatialindex import SpatialIndex
from relmap.core.map.globalmap import GlobalMap
from relmap.core.state.schedule import GroupingSchedule
from relmap.core.state.table import LandmarkState
from relmap.points.model import PointModel
from relmap.simulation import simulate_figure_eight
from tests.worlds import (
    aligned_rmse,
    fed,
    limit_of,
    mapped,
    purity_of,
    seen,
    stands_for,
    walk,
    without_ids,
)

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])


def test_landmarks_seen_again_are_merged_and_none_wrongly() -> None:
    world = simulate_figure_eight(iterations=1800, seed=1)
    mapper, labels = without_ids(world.log)
    labels = mapper.landmarks_of(labels)
    assert purity_of(labels, world.log.ids) == 1
    id_of = stands_for(labels, world.log.ids)
    true = [id_of[label] for label in mapper.map.landmark_ids]
    assert len(true) / len(np.unique(true)) <= 1.1
    assert len(np.unique(true)) == len(world.landmark_ids)
    mapper.refine()
    assert purity_of(mapper.landmarks_of(labels), world.log.ids) == 1
    true = [id_of[label] for label in mapper.map.landmark_ids]
    assert len(np.unique(true)) == len(world.landmark_ids)
    refined = aligned_rmse(mapper.map.positions, world.landmarks_map[true])
    assert refined <= 1.5 * limit_of(world.log, world.landmarks_map)


@pytest.mark.parametrize("seed", [0, 2])
def test_finish_and_refining_merge_what_the_drift_kept_apart(seed: int) -> None:
    world = simulate_figure_eight(density=25, seed=seed)
    mapper = fed(PointMapper(), seen(world.log, known=False))
    n = len(world.landmark_ids)
    assert len(mapper.map.landmark_ids) > n
    mapper.finish()
    mapper.refine()
    assert len(mapper.map.landmark_ids) == n


def test_old_landmarks_are_found_where_the_map_has_moved_them() -> None:
    table = LandmarkState()
    table.resize(12, 0, 2)
    global_map, merger = GlobalMap(table), Merger(table, PointModel(), 5)
    old, new = np.arange(6), np.arange(6, 12)
    places = np.random.default_rng(0).uniform(0, 20, (6, 2))
    submap = global_map.new_submap()
    global_map.place(submap, old, places, np.full(6, 10.0))
    GroupingSchedule(table, MapperConfig()).see(old, 1)
    table.highest_level[:] = 3
    assert not len(merger.find(old, 0.01))
    merger.leave(old)
    global_map.move(old, places + 100.0)
    merger.look_again()
    merger.go_on()
    table.first[new] = 50
    GroupingSchedule(table, MapperConfig()).see(new, 60)
    global_map.place(submap, new, places + 100.0, np.full(6, 10.0))
    found = merger.find(new, 0.01)
    assert sorted(found.tolist()) == np.column_stack([new, old]).tolist()


def test_labels_given_earlier_are_brought_up_to_date() -> None:
    world = simulate_figure_eight(seed=1)
    mapper, labels = without_ids(world.log)
    labels, table = mapper.landmarks_of(labels), mapper.landmarks
    assert set(labels) == set(table.landmark)
    present, counts = np.unique(labels, return_counts=True)
    np.testing.assert_array_equal(present, table.landmark)
    np.testing.assert_array_equal(counts, table.observations)


def test_known_landmarks_are_never_merged() -> None:
    world = walk(3, 3)
    twins = [
        (np.concatenate([ids, ids + 1000]), np.vstack([points, points]))
        for ids, points in world.scans
    ]
    assert len(mapped(twins).map.landmark_ids) == 2 * len(mapped(world.scans).map.landmark_ids)


def test_identity_follows_chains_of_merges() -> None:
    table = LandmarkState()
    table.resize(6, 0, 2)
    global_map = GlobalMap(table)
    global_map.place(global_map.new_submap(), np.arange(6), np.zeros((6, 2)), np.ones(6))
    table.merge(np.array([4]), np.array([2]))
    table.merge(np.array([5]), np.array([2]))
    table.merge(np.array([2]), np.array([0]))
    assert table.landmark_of.tolist() == [0, 1, 0, 3, 0, 0]
    assert table.is_own.tolist() == [True, True, False, True, False, False]


@given(seeds, dimensions)
def test_index_finds_all_that_is_near(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.normal(0, 5, (60, d))
    table = LandmarkState()
    table.resize(60, 0, d)
    index = SpatialIndex(table, 2.0)
    table.position[:], table.weight[:] = positions, 1.0
    index.add(np.arange(60))
    table.last[:] = rng.integers(0, 9, 60)
    asked, before = rng.normal(0, 5, (10, d)), rng.integers(0, 10, 10)
    of, found = index.near(asked, before)
    for k, position in enumerate(asked):
        earlier = table.last < before[k]
        near = np.linalg.norm(positions - position, axis=1) <= 2.0
        own = found[of == k]
        assert set(np.flatnonzero(near & earlier).tolist()) <= set(own.tolist())
        assert earlier[own].all()


def test_merged_landmarks_absorb_no_others() -> None:
    shift = np.array([0.4, 0.0])
    first, others = np.array([0.0, 0.0]), np.array([[3.0, 1.0], [-2.0, 4.0], [1.0, -5.0]])
    # 1 lies where 0 has drifted to, and 2 where 1 has: a chain; the rest are plain pairs.
    places = np.vstack([first, first + shift, first + 2 * shift, others, others + shift])
    pairs = np.array([[1, 0], [2, 1], [6, 3], [7, 4], [8, 5]])
    found = chosen(places, pairs, 0.05)
    assert len(found) >= 4
    assert not np.isin(found[:, 1], found[:, 0]).any()


@pytest.mark.parametrize("d", [2, 3])
def test_a_constellation_needs_three_landmarks_and_in_space_one_more(d: int) -> None:
    """Any two lie like two others; three in space fit their mirror image."""
    rng = np.random.default_rng(d)
    for n in range(1, 6):
        old = rng.uniform(-9, 9, (n, d))
        places = np.vstack([old, old + np.full(d, 0.5)])
        pairs = np.column_stack([np.arange(n, 2 * n), np.arange(n)])
        assert chosen(places, pairs, 0.05).tolist() == (pairs.tolist() if n > d else [])
