from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from relmap import PointMapper
from relmap.core.identity import Identity
from relmap.core.landmarks import MappedGroup
from relmap.core.refinement import gathered, refine
from relmap.core.spatialindex import SpatialIndex
from relmap.evaluation.baselines.batch import Batch, batch_least_squares
from relmap.evaluation.metrics import majority_ids, purity
from relmap.simulation import FigureEight, simulate_figure_eight
from tests.worlds import aligned_rmse, mapped, random_rotation, walk

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])


def mapped_without_ids(world: FigureEight) -> tuple[PointMapper, NDArray[np.int64]]:
    """Map without ids; return the mapper and the landmark of every observation."""
    mapper = PointMapper()
    labels = [mapper.update(scan.points_robot) for scan in world.log.scans()]
    mapper.finish()
    return mapper, mapper.landmarks_of(np.concatenate(labels))


@pytest.mark.parametrize(("density", "iterations"), [(25, 900), (25, 1800)])
def test_landmarks_seen_again_are_merged_and_none_wrongly(density: float, iterations: int) -> None:
    world = simulate_figure_eight(density=density, iterations=iterations, seed=1)
    assert world.log.ids is not None
    mapper, labels = mapped_without_ids(world)
    assert purity(labels, world.log.ids) == 1
    stands_for = dict(zip(*majority_ids(labels, world.log.ids)[:2], strict=True))
    true = [stands_for[label] for label in mapper.map.landmark_ids]
    assert len(true) / len(np.unique(true)) <= 1.1
    assert len(np.unique(true)) == len(world.landmark_ids)
    mapper.refine()
    refined = aligned_rmse(mapper.map.positions, world.landmarks_map[true])
    observations = Batch(world.log.points_robot, world.log.iteration, world.log.ids)
    limit = aligned_rmse(
        batch_least_squares(observations, world.landmarks_map), world.landmarks_map
    )
    assert refined <= 1.5 * limit


def test_labels_given_earlier_are_brought_up_to_date() -> None:
    world = simulate_figure_eight(seed=1)
    mapper, labels = mapped_without_ids(world)
    table = mapper.landmarks
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
    identity = Identity()
    identity.resize(6)
    identity.merge(4, 2)
    identity.merge(5, 2)
    identity.merge(2, 0)
    assert identity.of(np.arange(6)).tolist() == [0, 1, 0, 3, 0, 0]
    assert identity.own.tolist() == [True, True, False, True, False, False]


@given(seeds, dimensions)
def test_index_finds_all_that_is_near(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.normal(0, 5, (60, d))
    index = SpatialIndex(2.0, d)
    index.add(np.arange(60), positions)
    for position in rng.normal(0, 5, (10, d)):
        near = np.flatnonzero(np.linalg.norm(positions - position, axis=1) <= 2.0)
        assert set(near.tolist()) <= set(index.near(position))


def group_of(
    members: NDArray[np.int64], relative_map: NDArray[np.float64], n: NDArray[np.int64]
) -> MappedGroup:
    d = relative_map.shape[1]
    none = np.empty(0, dtype=np.int64)
    return MappedGroup(
        landmarks=members,
        relative_map=relative_map,
        n_observations=n,
        iterations=np.arange(10),
        fitted=none,
        R=np.empty((0, d, d)),
        t=np.empty((0, d)),
    )


def overlapping_groups(
    d: int, seed: int, sigma: float
) -> tuple[NDArray[np.float64], list[MappedGroup]]:
    """Return landmarks on a ring and groups of neighbours, each in a frame of its own."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    truth = np.column_stack([30 * np.cos(angle), 30 * np.sin(angle), rng.uniform(-3, 3, 60)])[:, :d]
    truth += rng.normal(0, 2, truth.shape)
    groups = []
    for first in range(0, 60, 5):
        members = np.arange(first, first + 15) % 60
        n = rng.integers(5, 15, 15)
        noise = sigma * rng.normal(size=(15, d)) / np.sqrt(n)[:, None]
        seen = truth[members] @ random_rotation(d, 3.0, rng).T + rng.normal(0, 9, d) + noise
        groups.append(group_of(members, seen, n))
    return truth, groups


@settings(max_examples=20)
@given(seeds, dimensions)
def test_refinement_is_exact_without_noise(seed: int, d: int) -> None:
    truth, groups = overlapping_groups(d, seed, sigma=0.0)
    start = truth + 0.3 * np.random.default_rng(seed).normal(size=truth.shape)
    observations = gathered(groups, np.ones(60, dtype=bool), np.arange(60))
    assert aligned_rmse(refine(observations, start), truth) < 1e-9


@pytest.mark.parametrize("d", [2, 3])
def test_refinement_reaches_batch_least_squares(d: int) -> None:
    truth, groups = overlapping_groups(d, 7, sigma=0.1)
    same_weight = [group_of(g.landmarks, g.relative_map, np.full(15, 3)) for g in groups]
    observations = gathered(same_weight, np.ones(60, dtype=bool), np.arange(60))
    points, pose = observations.points, observations.group
    expected = batch_least_squares(Batch(points, pose, observations.landmark), truth)
    assert aligned_rmse(refine(observations, truth), expected) < 1e-6


def test_refinement_keeps_what_it_cannot_improve() -> None:
    mapper = mapped(walk(3, 5).scans)
    before = mapper.map.positions
    mapper.refine()
    np.testing.assert_allclose(mapper.map.positions, before, atol=1e-9)
    empty = PointMapper()
    empty.refine()
    assert len(empty.map.positions) == 0


def test_refinement_halves_the_drift_of_the_eight() -> None:
    chained, refined = [], []
    for seed in range(4):
        world = simulate_figure_eight(seed=seed)
        mapper = PointMapper()
        for scan in world.log.scans():
            mapper.update(scan.points_robot, scan.ids)
        mapper.finish()
        chained.append(aligned_rmse(mapper.map.positions, world.landmarks_map))
        mapper.refine()
        refined.append(aligned_rmse(mapper.map.positions, world.landmarks_map))
    assert np.median(refined) < 0.5 * np.median(chained)
