from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.core.arrays import Floats, Ints
from relmap.core.refinement.condensing import LENGTH, NOWHERE, CondensedSegments, SegmentRows
from relmap.core.state.store import ObservationStore
from tests.worlds import aligned_rmse, random_rotation, walk

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
Scans = list[tuple[Ints, Floats]]


def stored(scans: Scans) -> ObservationStore:
    store = ObservationStore()
    for landmarks, points in scans:
        store.append(landmarks, points)
    return store


def condensed(scans: Scans) -> SegmentRows:
    none = np.zeros(1000, dtype=bool)
    return CondensedSegments().with_rest(stored(scans), none)


def observations_of(rows: SegmentRows) -> list[tuple[int, int]]:
    """Return iteration and landmark of every observation, in order."""
    row, bit = np.nonzero((rows.visible[:, None] >> np.arange(LENGTH)) & 1)
    at = rows.first_iteration[rows.segment[row]] + bit
    return sorted(zip(at.tolist(), rows.landmark[row].tolist(), strict=True))


@settings(max_examples=10, deadline=None)
@given(seeds, dimensions)
def test_each_observation_counts_exactly_once(seed: int, d: int) -> None:
    world = walk(d, seed, sigma=0.05, iterations=60)
    rows = condensed(world.scans)
    expected = sorted((k, int(i)) for k, (ids, _) in enumerate(world.scans) for i in ids)
    assert observations_of(rows) == expected
    assert rows.n_seen.sum() == len(expected)


def test_forgetting_on_the_way_changes_nothing() -> None:
    world = walk(3, 2, sigma=0.05, iterations=61)
    store, segments, none = ObservationStore(), CondensedSegments(), np.zeros(1000, dtype=bool)
    for k, (landmarks, points) in enumerate(world.scans):
        store.append(landmarks, points)
        segments.condense(store, k - 10, none)
        store.forget(min(max(k - 10, 0), segments.end))
    rows, expected = segments.with_rest(store, none), condensed(world.scans)
    np.testing.assert_array_equal(rows.points, expected.points)
    np.testing.assert_array_equal(rows.visible, expected.visible)
    np.testing.assert_array_equal(rows.R, expected.R)


@both_dimensions
def test_a_segment_is_the_least_squares_map_of_its_iterations(d: int) -> None:
    world = walk(d, 4, sigma=0.1)
    scans = world.scans[:LENGTH]
    rows = condensed(scans)
    assert rows.n_segments == 1
    ids = np.concatenate([ids for ids, _ in scans])
    points = np.concatenate([points for _, points in scans])
    pose = np.repeat(np.arange(LENGTH), [len(ids) for ids, _ in scans])
    landmarks, landmark = np.unique(ids, return_inverse=True)
    np.testing.assert_array_equal(rows.landmark, landmarks)
    expected = batch_least_squares(Batch(points, pose, landmark), world.landmarks[landmarks])
    assert aligned_rmse(rows.points, expected) < 1e-4
    placed = np.einsum("nij,nj->ni", rows.R[pose], points) + rows.t[pose]
    squares = np.sum((placed - rows.points[landmark]) ** 2)
    assert rows.squares[0] == pytest.approx(squares)


def test_outliers_and_movers_are_left_out() -> None:
    before = walk(3, 4, sigma=0.05).scans[:LENGTH]
    scans = [(ids, points.copy()) for ids, points in before]
    ids, points = scans[3]
    points[2] += [2.0, -4.0, 1.0]
    clean = condensed(before)
    rows = condensed(scans)
    assert set(observations_of(clean)) - set(observations_of(rows)) == {(3, int(ids[2]))}
    dynamic = np.zeros(1000, dtype=bool)
    dynamic[ids[2]] = True
    without = CondensedSegments().with_rest(stored(scans), dynamic)
    np.testing.assert_allclose(without.squares, clean.squares, rtol=0.2)
    assert without.freedoms[0] < clean.freedoms[0]
    moved = without.points[without.landmark == ids[2]] - clean.points[clean.landmark == ids[2]]
    assert np.linalg.norm(moved) > 0.2


def passage(d: int, seed: int) -> Scans:
    """Return scans of eight landmarks each; the latter four share five with the former four."""
    rng = np.random.default_rng(seed)
    landmarks, scans = rng.uniform(-10, 10, (11, d)), []
    for k in range(LENGTH):
        ids, R = np.arange(8) + 3 * (k > 3), random_rotation(d, 0.3, rng)
        noise = rng.normal(0, 0.05, (8, d))
        scans.append((ids, (landmarks[ids] + 0.2 * k) @ R + noise))
    return scans


@both_dimensions
@pytest.mark.parametrize("seed", range(5))
def test_wrong_observations_turn_no_iterations_against_others(d: int, seed: int) -> None:
    """The last scan before and the first after the change of view have a wrong observation each."""
    right = passage(d, seed)
    wrong = [(ids, points.copy()) for ids, points in right]
    wrong[3][1][4] *= -1.5
    wrong[4][1][2] = wrong[4][1][2] * -2 + 5
    rows, expected = condensed(wrong), condensed(right)
    assert set(observations_of(expected)) - set(observations_of(rows)) == {(3, 4), (4, 5)}
    assert rows.n_segments == 1
    assert rows.noise_m == pytest.approx(0.05, rel=0.25)
    assert aligned_rmse(rows.points, expected.points) < 0.03


def test_iterations_that_wrong_observations_tie_make_separate_segments() -> None:
    """One scan sees two landmarks of the earlier ones, one of them elsewhere."""
    rng = np.random.default_rng(0)
    landmarks, scans = rng.uniform(-10, 10, (10, 2)), []
    for k in range(LENGTH):
        ids = np.arange(5) + 5 * (k > 3)
        if k == 4:
            ids = np.append(ids, [0, 1])
        scans.append((ids, landmarks[ids] + 0.2 * k + rng.normal(0, 0.05, (len(ids), 2))))
    scans[4][1][-1] += [8.0, -6.0]
    rows = condensed(scans)
    assert rows.n_segments == 2
    assert rows.noise_m == pytest.approx(0.05, rel=0.25)


def test_iterations_that_share_too_little_make_separate_segments() -> None:
    rng = np.random.default_rng(0)
    here, there = rng.normal(0, 5, (6, 3)), rng.normal(0, 5, (5, 3))
    scans: Scans = [(np.arange(6), here), (np.arange(6), here)]
    scans += [(np.empty(0, dtype=np.int64), np.empty((0, 3))), (np.array([7]), here[:1])]
    scans += [(np.arange(10, 15), there), (np.arange(10, 15), there)]
    rows = condensed(scans)
    assert rows.n_segments == 2
    segment = rows.iteration_segment.tolist()
    assert segment == [0, 0, NOWHERE, NOWHERE, 1, 1]
    assert np.isnan(rows.t[2:4]).all()
    assert np.isfinite(rows.points).all()


def test_empty_iterations_condense_to_nothing() -> None:
    none: Scans = [(np.empty(0, dtype=np.int64), np.empty((0, 3)))] * 20
    rows = condensed(none)
    assert rows.n_segments == 0
    assert (rows.iteration_segment == NOWHERE).all()
    assert len(rows.iteration_segment) == 20
