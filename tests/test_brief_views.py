"""Landmarks that stay in view too briefly for a group are mapped nevertheless, without ids."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import PointMapper
from relmap.core.association.reobservation.merging import Merger
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.confirming import found_rest
from relmap.core.state.table import LandmarkState
from relmap.points.model import PointModel
from relmap.simulation import WorldSpec, simulate_world
from tests.worlds import aligned_rmse, purity_of, stands_for, without_ids

SIGMA_M = 0.03


def test_landmarks_seen_fewer_than_ten_times_are_mapped() -> None:
    world = simulate_world(WorldSpec(iterations=230, missed=0.3, seed=8))
    mapper, labels = without_ids(world.log)
    mapper.refine()
    labels = mapper.landmarks_of(labels)
    id_of = stands_for(labels, world.true_ids)
    true = [id_of[label] for submap in mapper.submaps for label in submap.landmark_ids]
    often = np.flatnonzero(np.bincount(world.true_ids[world.true_ids >= 0]) >= 10)
    assert np.isin(often, true).mean() >= 0.95
    assert purity_of(labels, world.true_ids) >= 0.998
    largest = [id_of[label] for label in mapper.map.landmark_ids]
    positions = mapper.map.positions[:, :2]
    assert aligned_rmse(positions, world.landmarks_map[largest, :2]) <= 1.0


def test_doubles_are_found_before_any_group_was_compared() -> None:
    rng = np.random.default_rng(0)
    place = rng.uniform(0, 20, (30, 2))
    table, everyone = LandmarkState(), np.arange(60)
    table.resize(60, 0, 2)
    global_map = GlobalMap(table)
    positions = np.vstack([place, place + 0.01 * rng.standard_normal((30, 2))])
    global_map.place(global_map.new_submap(), everyone, positions, np.full(60, 10.0))
    table.first[:] = table.since[:] = 2 * everyone
    table.last[:] = 2 * everyone + 30
    found = Merger(table, PointModel(), 10).doubles(0.02)
    assert np.isin(np.arange(30, 60), found).mean() >= 0.9


def test_a_submap_from_a_segment_averages_merged_tracks() -> None:
    points = np.random.default_rng(0).uniform(0, 20, (7, 2))
    points[6] = points[5] + [0.03, 0.0]
    table, everyone = LandmarkState(), np.arange(7)
    table.resize(7, 0, 2)
    table.merge(np.array([6]), np.array([5]))
    visible = np.array([0xFF] * 5 + [0x01, 0x06], dtype=np.uint8)  # seen once, and twice
    none, pose = np.zeros(1, dtype=np.int64), np.eye(2)[None]
    zero = np.zeros(7, dtype=np.int64)
    rows = SegmentRows(
        everyone, zero, points, visible, none, np.zeros(1), none, none, pose, np.zeros((1, 2))
    )
    found_rest(GlobalMap(table), rows)
    assert table.weight[5] == 3
    np.testing.assert_allclose(table.position[5], points[5] + [0.02, 0.0], atol=1e-12)
    np.testing.assert_allclose(table.position[:5], points[:5], atol=1e-12)


@pytest.mark.parametrize("seed", [1, 2])
def test_views_of_a_sensor_that_spins_in_space_are_joined(seed: int) -> None:
    rng, mapper = np.random.default_rng(seed), PointMapper()
    landmarks = np.column_stack([rng.uniform(-10, 10, (70, 2)), rng.uniform(-1, 2, 70)])
    for turned_rad in np.deg2rad(25.0) * np.arange(90):  # four scans in a row show a landmark
        local = landmarks @ Rotation.from_euler("z", turned_rad).as_matrix()
        seen = local[np.abs(np.arctan2(local[:, 1], local[:, 0])) <= np.deg2rad(45)]
        mapper.update(seen + SIGMA_M * rng.normal(size=seen.shape))
    mapper.finish()
    mapper.refine()
    assert len(mapper.submaps) == 1
    assert 0.8 * SIGMA_M < mapper.noise_m < 1.2 * SIGMA_M
