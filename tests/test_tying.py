"""Submaps that show the same place are joined without ids, others are not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap import PointMapper
from relmap.core import afterwards, repairing
from relmap.core.arrays import Floats
from relmap.core.association.reobservation.disagreement import local_drift
from relmap.core.association.reobservation.evidence import LOCAL_DRIFT
from relmap.core.association.reobservation.tying import NEIGHBOURHOOD, neighbourhoods, tie_submaps
from relmap.core.config import MapperConfig
from relmap.core.map.globalmap import GlobalMap
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.condensing import LENGTH
from relmap.core.state.schedule import GroupingSchedule
from relmap.core.state.table import NONE, LandmarkState
from relmap.points.model import PointModel
from tests.worlds import Scans, aligned_rmse, random_rotation, two_visits, walk

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])

Points = Floats

SIGMA = 0.02
"""Standard deviation of an observed coordinate, metres."""


def in_submaps(*places: Points) -> GlobalMap:
    """Return a map of submaps at positions (n, d), each in its own frame."""
    table, n, d = LandmarkState(), sum(map(len, places)), places[0].shape[1]
    table.resize(n, 0, d)
    global_map = GlobalMap(table)
    numbers = np.split(np.arange(n), np.cumsum([len(one) for one in places])[:-1])
    for landmarks, positions in zip(numbers, places, strict=True):
        weights = np.ones(len(landmarks))  # `moved` adds the noise of one observation
        global_map.place(global_map.new_submap(), landmarks, positions, weights)
    return global_map


def moved(points: Points, rng: np.random.Generator, sigma: float = 0.0) -> Points:
    d = points.shape[1]
    noise = sigma * rng.standard_normal(points.shape)
    return (points + noise) @ random_rotation(d, 3.0, rng).T + rng.uniform(-50, 50, d)


@settings(max_examples=20)
@given(seeds, dimensions, st.sampled_from([0.0, 0.02]))
def test_overlapping_submaps_are_joined(seed: int, d: int, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    world = rng.uniform(0, 20, (120, d))
    # They share what lies in the middle, more than half of the smaller submap.
    first, second = world[world[:, 0] < 15], world[world[:, 0] > 6]
    global_map = in_submaps(moved(first, rng, sigma), moved(second, rng, sigma))
    (tied,) = list(tie_submaps(global_map, sigma))
    assert len(tied) == len(first) + len(second)
    assert len(np.unique(global_map.table.submap)) == 1
    truth = np.vstack([first, second])
    assert aligned_rmse(global_map.table.position, truth) < max(1e-9, 5 * sigma)


@both_dimensions
def test_many_submaps_of_one_place_become_one(d: int) -> None:
    rng = np.random.default_rng(2)
    world = rng.uniform(0, 20, (60, d))
    global_map = in_submaps(*(moved(world, rng, 0.01) for _ in range(5)))
    for tied in tie_submaps(global_map, 0.01):  # of those that are the same one is left
        _, kept = np.unique(tied % len(world), return_index=True)
        global_map.table.take_off_map(np.delete(tied, kept))
    left = np.flatnonzero(global_map.table.submap != NONE)
    assert len(left) == len(world)
    assert aligned_rmse(global_map.table.position[left], world[left % len(world)]) < 0.05


@settings(max_examples=4)
@given(seeds, dimensions)
def test_different_places_stay_apart(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    global_map = in_submaps(*(rng.uniform(0, 20, (60, d)) for _ in range(4)))
    assert list(tie_submaps(global_map, 0.05)) == []
    assert len(np.unique(global_map.table.submap)) == 4


def test_rooms_that_differ_in_a_quarter_of_their_landmarks_stay_apart() -> None:
    """Eight landmarks are the same in all rooms, three are not, and may lie far from the others."""
    rng, n_tied = np.random.default_rng(5), 0
    for _ in range(5):
        common = rng.uniform(1, 9, (8, 2))
        own = [rng.uniform(1, 9, (3, 2)) for _ in range(8)]
        next_m = np.array([12.0, 0.0])
        rooms = [np.concatenate([common, each]) + k * next_m for k, each in enumerate(own)]
        pairs = (np.concatenate(rooms[k : k + 2]) for k in (0, 2, 4))
        global_map = in_submaps(*(moved(pair, rng, SIGMA) for pair in pairs))
        n_tied += len(list(tie_submaps(global_map, SIGMA)))
    assert n_tied <= 1


def test_few_landmarks_in_a_chance_arrangement_join_nothing() -> None:
    """Under large noise half of so few landmarks match somewhere in any world."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        global_map = in_submaps(*(rng.uniform(0, 10, (12, 2)) for _ in range(4)))
        assert list(tie_submaps(global_map, 0.2)) == []


@pytest.mark.parametrize("n", [5, 7])
def test_a_few_landmarks_are_joined_if_all_are_found_and_others_are_not(n: int) -> None:
    """Few triangles of a sparse map fit by chance, so few matches more are enough."""
    n_joined = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        world = rng.uniform(0, 60, (100, 2))
        again = world[np.argsort(np.linalg.norm(world - 30, axis=1))[:n]]
        for few, is_same in ((again, True), (rng.uniform(20, 40, (n, 2)), False)):
            global_map = in_submaps(world, moved(few, rng, 0.02))
            tied = list(tie_submaps(global_map, 0.03))
            n_joined += bool(tied) and is_same
            assert is_same or not tied
    assert n_joined >= 10


@pytest.mark.parametrize("seed", range(3))
@both_dimensions
def test_a_copy_that_deviates_by_more_than_the_noise_joins_nothing(d: int, seed: int) -> None:
    """Everything is found within the tolerance, but averaged landmarks are better known."""
    rng, n_averaged, sigma = np.random.default_rng(seed), 25, 0.05
    motif = rng.uniform(0, 12, (20, d))
    for deviation, is_same in ((0.0, True), (0.05, False)):
        copies = (motif + deviation * rng.standard_normal(motif.shape) for _ in range(2))
        global_map = in_submaps(*(moved(copy, rng, sigma / 5) for copy in copies))
        global_map.table.weight[:] = n_averaged
        assert len(list(tie_submaps(global_map, sigma))) == is_same


@both_dimensions
def test_an_ambiguous_place_joins_nothing(d: int) -> None:
    rng = np.random.default_rng(0)
    motif = rng.uniform(0, 8, (14, d))
    street = np.vstack([motif + np.eye(d)[0] * 12 * k for k in range(5)])
    global_map = in_submaps(street, moved(motif, rng))
    assert list(tie_submaps(global_map, 0.01)) == []


def test_landmarks_on_a_grid_join_nothing() -> None:
    grid = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(1)
    first, second = (part + 0.01 * rng.standard_normal(part.shape) for part in (grid, grid[:60]))
    assert list(tie_submaps(in_submaps(first, second), 0.01)) == []


def test_empty_maps_and_single_submaps_join_nothing() -> None:
    assert list(tie_submaps(GlobalMap(LandmarkState()), 0.01)) == []
    alone = in_submaps(np.random.default_rng(0).uniform(0, 9, (30, 3)))
    assert list(tie_submaps(alone, 0.01)) == []
    alone.table.take_off_map(np.arange(20))
    assert list(tie_submaps(alone, 0.01)) == []
    assert (alone.table.submap[:20] == NONE).all()


@given(seeds, st.integers(1, 70))
def test_everyone_is_in_a_neighbourhood(seed: int, n: int) -> None:
    positions = np.random.default_rng(seed).uniform(0, 9, (n, 2))
    found = list(neighbourhoods(positions))
    assert set(np.concatenate(found).tolist()) == set(range(n))
    assert all(len(np.unique(one)) == min(n, NEIGHBOURHOOD) for one in found)


@both_dimensions
@pytest.mark.parametrize("sigma", [0.0, 0.01])
def test_a_second_visit_from_nowhere_is_the_same_place(d: int, sigma: float) -> None:
    world = walk(d, 3, sigma)
    mapper, labels, true = PointMapper(), [], []
    for ids, points in [*world.scans, *world.scans]:
        labels.append(mapper.update(points))
        true.append(ids)
    mapper.finish()
    mapper.refine()
    assert len(mapper.submaps) == 1
    found = mapper.landmarks_of(np.concatenate(labels))
    pairs = np.unique(np.column_stack([found, np.concatenate(true)]), axis=0)
    stands_for = dict(pairs.tolist())
    assert len(stands_for) == len(pairs)  # no landmark stands for two
    mapped = [stands_for[label] for label in mapper.map.landmark_ids.tolist()]
    assert len(set(mapped)) >= len(world.landmarks) - 2
    assert len(mapped) <= 1.1 * len(set(mapped))
    assert aligned_rmse(mapper.map.positions[:, :d], world.landmarks[mapped]) < max(1e-9, sigma)


def biased(d: int, seed: int, bias_m: float, visits: int) -> Scans:
    """Return scans of a walk in which each landmark is biased anew in each segment."""
    world, rng = walk(d, seed, SIGMA), np.random.default_rng(seed)
    scans = []
    for k, (ids, points) in enumerate(visits * world.scans):
        if k % LENGTH == 0:
            bias = bias_m * rng.standard_normal(world.landmarks.shape)
        scans.append((ids, points + bias[ids]))
    return scans


@both_dimensions
@pytest.mark.parametrize("bias_m", [0.0, 0.02, 0.1])
def test_disagreement_of_segments_is_known(d: int, bias_m: float) -> None:
    engine, true = RelativeMapper(PointModel(), MapperConfig()), (bias_m / SIGMA) ** 2
    for ids, points in biased(d, 0, bias_m, visits=1):
        engine.update(points, ids)
    afterwards.finish(engine)
    repairing.refine(engine)
    drift = local_drift(engine.table, engine.rows, SIGMA)
    # Each landmark is averaged over few segments, which takes a part of the bias with it.
    if bias_m == 0:
        assert drift == LOCAL_DRIFT
    else:
        assert 0.6 * true < drift < 1.1 * true


@both_dimensions
@pytest.mark.parametrize("seed", range(2))
def test_a_place_is_found_again_by_segments_that_disagree(d: int, seed: int) -> None:
    """As those of Victoria Park do, by more than the noise of averages."""
    mapper = PointMapper()
    for _, points in biased(d, seed, 2 * SIGMA, visits=2):
        mapper.update(points)
    mapper.finish()
    mapper.refine()
    assert len(mapper.submaps) == 1


@both_dimensions
@pytest.mark.parametrize("seed", range(8))
def test_no_duplicates_remain_after_a_brief_second_visit(d: int, seed: int) -> None:
    place, scans = two_visits(d, seed)
    mapper, labels = PointMapper(), []
    for _, points in scans:
        labels.append(mapper.update(points))
    of, true = np.concatenate(labels), np.concatenate([ids for ids, _ in scans])
    stands_for = dict(np.column_stack([of, true]).tolist())
    assert len(stands_for) == len(np.unique(np.column_stack([of, true]), axis=0))
    assert set(labels[0]).isdisjoint(labels[-1])  # the second visit is not tied to the first
    for step in (mapper.finish, mapper.refine):
        step()
        found = mapper.landmarks_of(of)
        stands_for = dict(np.column_stack([found, true]).tolist())
        assert len(stands_for) == len(np.unique(np.column_stack([found, true]), axis=0))
        assert len(mapper.submaps) == 1
        mapped = [stands_for[label] for label in mapper.map.landmark_ids.tolist()]
        assert len(mapped) == len(set(mapped))
    assert aligned_rmse(mapper.map.positions[:, :d], place[mapped]) < 0.02


@given(seeds)
def test_later_landmarks_were_never_seen_meanwhile(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table, seen = LandmarkState(), {k: {0} for k in range(6)}
    order = rng.permutation(6)
    begin = np.zeros(6, dtype=np.int64)
    for iteration, k in enumerate(order.tolist()):  # six stretches, some of which overlap
        begin[k] = 4 * iteration
    length = rng.integers(1, 9, 6)
    numbers = np.argsort(begin)
    for number, k in enumerate(numbers.tolist()):
        table.resize(number + 1, int(begin[k]), 2)
        for iteration in range(begin[k], begin[k] + length[k]):
            table.enter(np.array([number]), np.zeros((1, 2)), iteration)
            GroupingSchedule(table, MapperConfig()).see(np.array([number]), iteration)
        seen[number] = set(range(begin[k], begin[k] + length[k]))
    present = list(range(6))
    while len(present) > 1:
        new, old = rng.choice(present, 2, replace=False).tolist()
        apart = not seen[new] & seen[old] and max(seen[old]) < max(seen[new])
        stretches_touch = apart and not table.is_later(new, old)
        if table.is_later(new, old):
            assert apart
            table.merge(np.array([new]), np.array([old]))
            seen[old] |= seen[new]
        elif stretches_touch:
            raise AssertionError((seen[new], seen[old]))
        present.remove(new)
        if table.last[old] == max(seen[old]):
            assert table.first[old] == min(seen[old])
