from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.map.globalmap import GlobalMap
from relmap.core.state.table import NONE, LandmarkState
from tests.worlds import random_rotation

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
Points = Floats


def empty_map(n: int, d: int) -> GlobalMap:
    table = LandmarkState()
    table.resize(n, 0, d)
    return GlobalMap(table)


def average_in(
    global_map: GlobalMap, submap: int, landmarks: Ints, positions: Points, weights: Points
) -> None:
    """Average positions into a submap, as a new interval of the landmarks does."""
    global_map.join(submap, landmarks, positions)
    global_map.table.settle(landmarks)
    global_map.place(submap, landmarks, positions, weights)


def elsewhere(points: Points, rng: np.random.Generator) -> Points:
    """Transform points into another frame."""
    d = points.shape[1]
    return np.asarray(points @ random_rotation(d, 3.0, rng).T + rng.uniform(-50, 50, d))


def distances(points: Points) -> Points:
    return np.asarray(np.linalg.norm(points[:, None] - points, axis=2))


@settings(max_examples=40)
@given(seeds, dimensions)
def test_positions_are_the_weighted_means_of_what_was_averaged_in(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    global_map = empty_map(8, d)
    submap = global_map.new_submap()
    given_positions: list[list[Points]] = [[] for _ in range(8)]
    given_weights: list[list[float]] = [[] for _ in range(8)]
    for _ in range(6):
        landmarks = rng.permutation(8)[: rng.integers(1, 9)]
        positions = rng.normal(size=(len(landmarks), d))
        weights = rng.integers(1, 10, len(landmarks)).astype(float)
        average_in(global_map, submap, landmarks, positions, weights)
        for landmark, position, weight in zip(landmarks, positions, weights, strict=True):
            given_positions[landmark].append(position)
            given_weights[landmark].append(weight)
    for landmark in range(8):
        if not given_weights[landmark]:
            assert global_map.table.submap[landmark] == NONE
            assert np.isnan(global_map.table.position[landmark]).all()
            assert global_map.table.weight[landmark] == 0
            continue
        mean = np.average(given_positions[landmark], axis=0, weights=given_weights[landmark])
        np.testing.assert_allclose(global_map.table.position[landmark], mean, atol=1e-12)
        assert global_map.table.weight[landmark] == sum(given_weights[landmark])
        assert global_map.table.submap[landmark] == submap


def test_a_better_group_takes_the_place_of_what_is_not_settled() -> None:
    global_map = empty_map(2, 2)
    submap = global_map.new_submap()
    both = np.arange(2)
    global_map.place(submap, both, np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([5.0, 5.0]))
    global_map.place(submap, both, np.array([[2.0, 2.0], [5.0, 4.0]]), np.array([8.0, 8.0]))
    np.testing.assert_allclose(global_map.table.position, [[2.0, 2.0], [5.0, 4.0]])
    np.testing.assert_array_equal(global_map.table.weight, [8.0, 8.0])
    global_map.table.settle(both[:1])
    global_map.place(submap, both, np.array([[6.0, 2.0], [6.0, 4.0]]), np.array([8.0, 8.0]))
    np.testing.assert_allclose(global_map.table.position, [[4.0, 2.0], [6.0, 4.0]])
    np.testing.assert_array_equal(global_map.table.weight, [16.0, 8.0])


def test_what_is_settled_moves_with_the_landmark() -> None:
    global_map = empty_map(1, 2)
    submap = global_map.new_submap()
    only = np.arange(1)
    average_in(global_map, submap, only, np.array([[1.0, 1.0]]), np.array([5.0]))
    global_map.table.settle(only)
    global_map.move(only, np.array([[3.0, 1.0]]))
    global_map.place(submap, only, np.array([[5.0, 1.0]]), np.array([5.0]))
    np.testing.assert_allclose(global_map.table.position, [[4.0, 1.0]])


def test_one_that_turns_out_to_be_another_keeps_what_is_settled_of_both() -> None:
    global_map = empty_map(2, 2)
    submap = global_map.new_submap()
    for landmark, x, weight in ((0, 1.0, 6.0), (1, 4.0, 2.0)):
        only = np.array([landmark])
        average_in(global_map, submap, only, np.array([[x, 0.0]]), np.array([weight]))
        global_map.table.settle(only)
    global_map.place(submap, np.array([1]), np.array([[8.0, 0.0]]), np.array([2.0]))
    global_map.table.merge(np.array([1]), np.array([0]))
    assert global_map.table.submap.tolist() == [submap, NONE]
    np.testing.assert_allclose(global_map.table.position[0], [(6 * 1 + 2 * 4 + 2 * 8) / 10, 0.0])
    global_map.place(submap, np.array([0]), np.array([[3.0, 0.0]]), np.array([8.0]))
    np.testing.assert_allclose(global_map.table.position[0], [(6 * 1 + 2 * 4 + 8 * 3) / 16, 0.0])


def test_what_is_removed_begins_again() -> None:
    global_map = empty_map(3, 2)
    submap = global_map.new_submap()
    everything = np.arange(3)
    average_in(global_map, submap, everything, np.eye(3, 2), np.full(3, 4.0))
    global_map.table.take_off_map(np.array([1]))
    assert global_map.table.submap.tolist() == [submap, NONE, submap]
    assert global_map.table.weight.tolist() == [4.0, 0.0, 4.0]
    assert np.isnan(global_map.table.position[1]).all()
    assert global_map.weights_in(submap, everything).tolist() == [4.0, 0.0, 4.0]
    average_in(global_map, submap, np.array([1]), np.array([[7.0, 7.0]]), np.array([2.0]))
    np.testing.assert_array_equal(global_map.table.position[1], [7.0, 7.0])
    assert global_map.table.weight[1] == 2.0


def test_room_for_more_keeps_what_is_there() -> None:
    global_map = empty_map(2, 3)
    submap = global_map.new_submap()
    average_in(global_map, submap, np.arange(2), np.ones((2, 3)), np.ones(2))
    global_map.table.resize(100, 0, 3)
    assert (
        len(global_map.table.position)
        == len(global_map.table.weight)
        == len(global_map.table.submap)
        == 100
    )
    np.testing.assert_array_equal(global_map.table.position[:2], np.ones((2, 3)))
    assert np.isnan(global_map.table.position[2:]).all()
    assert set(global_map.table.submap[2:].tolist()) == {NONE}


def test_submaps_come_with_the_oldest_first() -> None:
    global_map = empty_map(9, 2)
    first, second = global_map.new_submap(), global_map.new_submap()
    assert first != second
    average_in(global_map, second, np.arange(3, 8), np.eye(5, 2), np.ones(5))
    average_in(global_map, first, np.arange(3), np.eye(3, 2), np.ones(3))
    assert global_map.submaps_of(np.arange(9)).tolist() == [first, second]
    assert global_map.submaps_of(np.arange(9), 4).tolist() == [second]
    assert global_map.submaps_of(np.array([3, 8])).tolist() == [second]
    assert global_map.submaps_of(np.array([8])).tolist() == []
    assert global_map.weights_in(first, np.array([2, 3, 8])).tolist() == [1.0, 0.0, 0.0]


@settings(max_examples=15)
@given(seeds, dimensions)
def test_align_is_the_weighted_least_squares_fit(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-5, 5, (7, d))
    in_map, n_iterations = rng.uniform(1, 20, 5), rng.integers(1, 20, 7)
    global_map = empty_map(7, d)
    submap = global_map.new_submap()
    there = places[:5] + 0.1 * rng.standard_normal((5, d))
    average_in(global_map, submap, np.arange(5), there, in_map)
    relative = elsewhere(places, rng) + 0.1 * rng.standard_normal((7, d))
    placed = global_map.align(submap, np.arange(7), relative, n_iterations)
    assert placed is not None
    # A position averaged over n iterations has a variance of 1 / n; those of both sides add.
    root = 1 / np.sqrt(1 / in_map + 1 / n_iterations[:5])

    def rotation(turn: Points) -> Points:
        vector = turn if d == 3 else np.array([0.0, 0.0, turn[0]])
        return np.asarray(Rotation.from_rotvec(vector).as_matrix()[:d, :d])

    def cost(x: Points) -> Points:
        moved = relative[:5] @ rotation(x[d:]).T + x[:d]
        return np.asarray(((moved - there) * root[:, None]).ravel())

    starts = np.linspace(-3, 3, 5)[:, None] if d == 2 else Rotation.random(12, rng).as_rotvec()
    fits = [least_squares(cost, np.concatenate([np.zeros(d), s]), x_scale="jac") for s in starts]
    best = min(fits, key=lambda fit: float(fit.cost)).x
    np.testing.assert_allclose(placed, relative @ rotation(best[d:]).T + best[:d], atol=1e-4)


def test_align_needs_members_that_fix_a_rotation() -> None:
    global_map = empty_map(6, 3)
    submap = global_map.new_submap()
    line = np.outer(np.arange(5.0), [1.0, 2.0, 2.0])
    average_in(global_map, submap, np.arange(5), line, np.ones(5))
    ones = np.ones(6, dtype=np.int64)
    group = np.vstack([line, [[3.0, 0.0, 0.0]]])
    assert global_map.align(submap, np.arange(6), group, ones) is None
    assert global_map.align(submap, np.array([5]), group[5:], ones[5:]) is None


def fixes_well(points: Floats) -> bool:
    """Return whether points are apart in as many directions as fix a rotation."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[points.shape[1] - 2] > 1.0)


@settings(max_examples=30)
@given(seeds, dimensions)
def test_submaps_join_by_the_motion_that_ties_them(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    world = rng.uniform(-20, 20, (20, d))
    global_map = empty_map(20, d)
    first, second = global_map.new_submap(), global_map.new_submap()
    here, there = elsewhere(world, rng), elsewhere(world, rng)
    average_in(global_map, first, np.arange(10), here[:10], np.full(10, 3.0))
    average_in(global_map, second, np.arange(10, 19), there[10:19], np.full(9, 7.0))
    tie = np.array([5, 6, 7, 12, 13, 14, 15, 19])
    placed = global_map.align(first, tie, elsewhere(world[tie], rng), np.ones(8, dtype=np.int64))
    # Three nearly collinear ones determine the others poorly.
    assume(np.isfinite(placed).all())
    assume(fixes_well(here[5:8]))
    assume(fixes_well(there[12:15]))
    average_in(global_map, first, tie, placed, np.full(8, 2.0))
    assert len(set(global_map.table.submap.tolist())) == 1
    np.testing.assert_allclose(distances(global_map.table.position), distances(world), atol=1e-9)
    expected = np.repeat([3.0, 7.0, 0.0], [10, 9, 1])
    expected[tie] += 2.0
    np.testing.assert_array_equal(global_map.table.weight, expected)


@both_dimensions
def test_members_of_a_submap_that_they_do_not_fix_change_over_alone(d: int) -> None:
    rng = np.random.default_rng(d)
    world = rng.uniform(-20, 20, (10, d))
    global_map = empty_map(10, d)
    first, second = global_map.new_submap(), global_map.new_submap()
    there = elsewhere(world, rng)
    average_in(global_map, first, np.arange(5), world[:5], np.full(5, 3.0))
    average_in(global_map, second, np.arange(5, 10), there[5:], np.full(5, 7.0))
    tie = np.array([0, 1, 2, 3, 9])
    average_in(global_map, first, tie, world[tie], np.full(5, 2.0))
    assert global_map.table.submap.tolist() == [first] * 5 + [second] * 4 + [first]
    np.testing.assert_allclose(global_map.table.position[9], world[9], atol=1e-12)
    np.testing.assert_array_equal(global_map.table.position[5:9], there[5:9])
    assert global_map.table.weight[9] == 2.0


def driven(d: int) -> tuple[PointMapper, Points, int]:
    """Drive a road, lose sight, and come back to it from beyond; return mapper, road, and joint."""
    road = np.zeros((108, d))
    road[:, 0] = np.arange(108.0)
    road[:, 1:] = np.random.default_rng(d).uniform(-5, 5, (108, d - 1))
    mapper = PointMapper()

    def see(x: float) -> None:
        seen = np.flatnonzero(np.abs(road[:, 0] - x) < 6)
        mapper.update(road[seen] - np.eye(d)[0] * x, seen)

    for x in np.arange(6, 70, 0.5):
        see(x)
    for _ in range(12):
        mapper.update(np.empty((0, d)), np.empty(0, dtype=np.int64))
    for x in np.arange(101, 82, -0.5):
        see(x)
    n_submaps = len(mapper.submaps)
    for x in np.arange(82, 68, -0.5):
        see(x)
    mapper.finish()
    return mapper, road, n_submaps


@both_dimensions
def test_a_map_that_fell_apart_comes_together(d: int) -> None:
    mapper, road, n_submaps = driven(d)
    assert n_submaps == 2
    assert len(mapper.submaps) == 1
    found = mapper.map
    assert len(found.landmark_ids) >= 100
    true_distances = distances(road[found.landmark_ids])
    np.testing.assert_allclose(distances(found.positions[:, :d]), true_distances, atol=1e-8)


@both_dimensions
def test_the_frame_stays_that_of_the_first_pose_when_submaps_join(d: int) -> None:
    mapper, _, _ = driven(d)
    np.testing.assert_allclose(mapper.trajectory[0], np.eye(4), atol=1e-8)
