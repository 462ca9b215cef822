"""Landmarks that are in view for long or with gaps, or that start or stop moving."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap import MapperConfig, PointMapper
from relmap.core.arrays import Floats
from relmap.core.refinement.condensing import LENGTH
from relmap.core.state.schedule import LONGEST_INTERVAL
from tests.worlds import aligned_rmse, finished, random_rotation, walk

both_dimensions = pytest.mark.parametrize("d", [2, 3])
SIGMA = 0.05
Points = Floats


def scattered(n: int, d: int, rng: np.random.Generator) -> Points:
    return np.asarray(rng.uniform(-8, 8, (n, d)))


def spaced(n: int, d: int, rng: np.random.Generator) -> Points:
    """Scatter landmarks so far apart that without ids none can be taken for another."""
    while spacings(places := scattered(n, d, rng)).min() < 1.0:
        pass
    return places


def spacings(places: Points) -> Points:
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    return np.asarray(apart[np.triu_indices(len(places), k=1)])


def seen_from(places: Points, rng: np.random.Generator) -> Points:
    """Observe places (n, d) from a random pose, with noise."""
    d = places.shape[1]
    R, t = random_rotation(d, 0.1, rng), rng.uniform(-0.3, 0.3, d)
    return (places - t) @ R + SIGMA * rng.standard_normal(places.shape)


def n_stored(mapper: PointMapper) -> int:
    return mapper.engine.store.n_iterations - mapper.engine.store.first_iteration


@both_dimensions
@pytest.mark.parametrize("known", [True, False])
def test_what_stays_in_view_becomes_better_in_constant_memory(d: int, known: bool) -> None:
    errors, taken_for_others = [], 0
    for seed in range(2):
        rng, mapper = np.random.default_rng(seed), PointMapper()
        world, errors_of_run = spaced(15, d, rng), []
        for k in range(1000):
            labels = mapper.update(seen_from(world, rng), np.arange(15) if known else None)
            taken_for_others += int(np.sum(labels != np.arange(15)))
            assert n_stored(mapper) <= LONGEST_INTERVAL + 2 * LENGTH
            if k + 1 in (60, 250, 1000):
                assert len(mapper.map.landmark_ids) == 15
                errors_of_run.append(aligned_rmse(mapper.map.positions[:, :d], world))
        errors.append(errors_of_run)
        assert set(mapper.landmarks.level[:15]) == {3}
        assert (mapper.engine.table.weight[:15] >= 850).all()
    # Without ids a gate of 4.5 sigma shuts out an observation of many thousands.
    assert taken_for_others <= (0 if known else 4)
    at_60, at_250, at_1000 = np.sqrt(np.mean(np.square(errors), axis=0))
    # The error goes with one over the root of the number of observations.
    assert at_250 < 0.7 * at_60
    assert at_1000 < 0.7 * at_250
    assert at_1000 < 1.3 * SIGMA * np.sqrt(d / 1000)


@both_dimensions
def test_one_in_view_long_before_there_is_a_map_reaches_the_highest_level(d: int) -> None:
    rng, mapper = np.random.default_rng(d), PointMapper()
    world, early = scattered(15, d, rng), d
    for k in range(500):
        n = early if k < 300 else 15
        mapper.update(seen_from(world[:n], rng), np.arange(n))
    assert mapper.landmarks.level.tolist() == [3] * 15
    assert (mapper.engine.table.weight[:early] >= 180).all()


@both_dimensions
def test_a_landmark_with_gaps_gets_a_place(d: int) -> None:
    for seed in range(4):
        rng, mapper = np.random.default_rng(seed), PointMapper()
        world = scattered(14, d, rng)
        for k in range(300):
            there = np.ones(14, dtype=bool)
            there[12] = k % 12 < 4  # gone for longer than a track is carried along
            there[13] = rng.random() < 0.3
            mapper.update(seen_from(world, rng)[there], np.flatnonzero(there))
        mapper.finish()
        table = mapper.landmarks
        assert set(table.status) == {"static"}
        assert (table.level[12:] >= 2).all()
        placed = mapper.map.positions[:, :d]
        assert aligned_rmse(placed, world) < 0.02
        assert np.isfinite(placed).all()


@both_dimensions
def test_a_landmark_that_stops_is_mapped_where_it_stands(d: int) -> None:
    for seed in range(4):
        rng, mapper = np.random.default_rng(seed), PointMapper()
        world, way = scattered(16, d, rng), np.eye(d)[0]
        start = world[15].copy()
        for k in range(240):
            world[15] = start + 0.1 * min(k, 80) * way
            mapper.update(seen_from(world, rng), np.arange(16))
            if k == 79:
                assert mapper.landmarks.status[15] == "dynamic"
                assert mapper.landmarks.level[15] == 0
        mapper.finish()
        assert set(mapper.landmarks.status) == {"static"}
        assert aligned_rmse(mapper.map.positions[:, :d], world) < 0.02


@both_dimensions
def test_one_that_starts_leaves_the_map(d: int) -> None:
    for seed in range(4):
        rng, mapper = np.random.default_rng(seed), PointMapper()
        world, way = scattered(16, d, rng), np.eye(d)[0]
        for k in range(200):
            if k == 100:
                assert mapper.landmarks.status[15] == "static"
            world[15] += 0.1 * way * (k >= 100)
            mapper.update(seen_from(world, rng), np.arange(16))
        mapper.finish()
        table = mapper.landmarks
        assert table.status.tolist() == ["static"] * 15 + ["dynamic"]
        assert table.level[15] == 0
        assert np.isnan(table.position[15]).all()
        assert aligned_rmse(mapper.map.positions[:, :d], world[:15]) < 0.02


@both_dimensions
@pytest.mark.parametrize("known", [True, False])
def test_what_is_seen_only_once_does_not_queue_up(d: int, known: bool) -> None:
    rng, mapper = np.random.default_rng(d), PointMapper()
    world = spaced(15, d, rng)
    for k in range(400):
        clutter = scattered(3, d, rng)
        ids = np.concatenate([np.arange(15), 100 + 3 * k + np.arange(3)])
        mapper.update(np.vstack([seen_from(world, rng), clutter]), ids if known else None)
        assert len(mapper.engine.schedule.gone) <= 3 * 40
        assert n_stored(mapper) <= LONGEST_INTERVAL + 2 * LENGTH
    assert set(mapper.landmarks.level[:15]) == {3}


def settled_map(mapper: PointMapper) -> tuple[bytes, bytes]:
    return mapper.map.positions.tobytes(), mapper.map.landmark_ids.tobytes()


@both_dimensions
def test_finish_twice_is_finish_once(d: int) -> None:
    mapper = finished(PointMapper(), ((points, ids) for ids, points in walk(d, 3, SIGMA).scans))
    once = settled_map(mapper)
    mapper.finish()
    assert settled_map(mapper) == once


@both_dimensions
def test_after_finish_the_mapping_goes_on(d: int) -> None:
    world, mapper, plain = walk(d, 4, SIGMA, iterations=240), PointMapper(), PointMapper()
    for k, (ids, points) in enumerate(world.scans):
        if k in (80, 83, 160):
            mapper.finish()
        mapper.update(points, ids)
        plain.update(points, ids)
    mapper.finish()
    plain.finish()
    assert mapper.map.landmark_ids.tolist() == plain.map.landmark_ids.tolist()
    np.testing.assert_array_equal(mapper.landmarks.observations, plain.landmarks.observations)
    error, expected = (
        aligned_rmse(found.positions[:, :d], world.landmarks[found.landmark_ids])
        for found in (mapper.map, plain.map)
    )
    assert error < 2 * expected


@pytest.mark.parametrize("known", [True, False])
@both_dimensions
def test_a_group_after_every_observation(d: int, known: bool) -> None:
    world = walk(d, 5)
    mapper = finished(
        PointMapper(MapperConfig(group_after=1)),
        ((points, ids if known else None) for ids, points in world.scans),
    )
    found, seen = mapper.map, np.unique(np.concatenate([ids for ids, _ in world.scans]))
    assert len(found.landmark_ids) >= 0.9 * len(seen)
    if known:
        truth = world.landmarks[found.landmark_ids]
        assert aligned_rmse(found.positions[:, :d], truth) < 1e-9


def degenerate(kind: str, n: int, d: int, rng: np.random.Generator) -> Points:
    places = rng.uniform(-20, 60, (n, d))
    if kind == "line":
        places = np.outer(places[:, 0], np.ones(d))
    elif kind == "spot":
        places[:] = places[0]
    elif kind == "plane":
        places[:, -1] = 0.0
    elif kind == "twins":
        places[n // 2 :] = places[: n - n // 2]
    return places


@settings(max_examples=12)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([2, 3]),
    st.sampled_from(["line", "spot", "plane", "twins", "anywhere"]),
    st.integers(1, 40),
    st.sampled_from([1, 2, 5, 10]),
    st.sampled_from([0, 2, 5, 9]),
    st.booleans(),
)
def test_any_input_gives_finite_positions(
    seed: int, d: int, kind: str, n: int, after: int, missed: int, known: bool
) -> None:
    rng = np.random.default_rng(seed)
    places, sigma = degenerate(kind, n, d, rng), rng.choice([0.0, SIGMA])
    mapper = PointMapper(MapperConfig(group_after=after, max_missed=missed))
    for k in range(70):
        t = np.zeros(d)
        t[0] = 0.6 * k
        ids = np.flatnonzero((np.abs(places[:, 0] - t[0]) < 12) & (rng.random(n) > 0.15))
        points = places[ids] - t + sigma * rng.standard_normal((len(ids), d))
        mapper.update(points, ids if known else None)
        if k == 40:
            mapper.finish()
    mapper.finish()
    mapper.finish()
    table, state = mapper.landmarks, mapper.engine.table
    assert np.isfinite(mapper.map.positions).all()
    assert np.isfinite(table.position[table.level > 0]).all()
    np.testing.assert_array_equal(np.isfinite(state.position).all(axis=1), state.weight > 0)
    assert set(table.status) <= {"static", "dynamic", "unmapped"}
    assert len(np.unique(mapper.engine.schedule.in_view)) == len(mapper.engine.schedule.in_view)
