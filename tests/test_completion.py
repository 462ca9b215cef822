from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.core.grouping.chart import PointChart
from relmap.core.grouping.completion import RelativeMap, complete
from tests.worlds import random_rotation

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
Points = Floats


def seen_block(
    places: Points, i: int, sigma: float, rng: np.random.Generator
) -> tuple[Points, list[tuple[Points, Points]]]:
    """Observe places (n, d) in i iterations from random poses; return the poses too."""
    d = places.shape[1]
    turns = [random_rotation(d, 3.0, rng) for _ in range(i)]
    poses = list(zip(turns, rng.uniform(-20, 20, (i, d)), strict=True))
    block = np.stack([(places - t) @ R for R, t in poses], axis=1)
    return block + sigma * rng.standard_normal(block.shape), poses


def completed(block: Points, reference: Points) -> RelativeMap:
    n, i = block.shape[:2]
    chart = PointChart(np.arange(n), np.arange(i), block)
    return complete(chart, reference, np.zeros(n, dtype=bool), np.nan)


def reference_of(places: Points, members: slice | list[int]) -> Points:
    reference = np.full(places.shape, np.nan)
    reference[members] = places[members]
    return reference


def naive(block: Points, reference: Points) -> list[list[Points]]:
    """Return every observation of each landmark, its iteration fitted by scipy."""
    n, i, d = block.shape
    placed: list[list[Points]] = [[] for _ in range(n)]
    for k in range(i):
        shared = np.isfinite(block[:, k, 0]) & np.isfinite(reference[:, 0])
        here, there = np.zeros((shared.sum(), 3)), np.zeros((shared.sum(), 3))
        here[:, :d], there[:, :d] = block[shared, k], reference[shared]
        # Of nothing, old versions of numpy raise an error.
        if not len(here) or np.linalg.matrix_rank(here - here[:1]) < d - 1:
            continue
        a, b = here.mean(axis=0), there.mean(axis=0)
        if d == 2:
            cross = np.cross(here - a, there - b)[:, 2].sum()
            angle = np.arctan2(cross, np.sum((here - a) * (there - b)))
            R = Rotation.from_euler("Z", angle)
        else:
            R = Rotation.align_vectors(there - b, here - a)[0]
        for row in np.flatnonzero(np.isfinite(block[:, k, 0])):
            point = np.zeros(3)
            point[:d] = block[row, k]
            placed[row].append((R.apply(point - a) + b)[:d])
    return placed


@settings(max_examples=40)
@given(seeds, dimensions)
def test_completes_as_fitting_one_iteration_after_the_other_does(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-5, 5, (9, d))
    block, _ = seen_block(places, 7, 0.05, rng)
    block[rng.random(block.shape[:2]) < 0.35] = np.nan
    reference = reference_of(places, slice(0, 5))
    placed = naive(block, reference)
    relative = completed(block, reference)
    assert relative.landmarks.tolist() == [row for row in range(9) if placed[row]]
    for row, landmark in enumerate(relative.landmarks):
        expected = np.array(placed[landmark])
        np.testing.assert_allclose(relative.positions[row], expected.mean(axis=0), atol=1e-6)
        assert relative.n_used[row] == len(expected)
        assert not relative.used[row][~np.isfinite(block[landmark, :, 0])].any()


@settings(max_examples=30)
@given(seeds, dimensions)
def test_is_the_group_average_where_everybody_is_always_seen(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-5, 5, (6, d))
    block, poses = seen_block(places, 12, 0.0, rng)
    offsets = 0.01 * rng.standard_normal(block.shape)
    offsets[:4] = 0.0  # the reference is seen without noise, so each pose is the true one
    robot_offsets = np.stack([offsets[:, k] @ R for k, (R, _) in enumerate(poses)], axis=1)
    relative = completed(block + robot_offsets, reference_of(places, slice(0, 4)))
    np.testing.assert_array_equal(relative.n_used, np.full(6, 12))
    np.testing.assert_allclose(relative.positions, places + offsets.mean(axis=1), atol=1e-9)


@settings(max_examples=30)
@given(seeds, dimensions, st.floats(0, 0.6))
def test_without_noise_it_is_exact_whatever_is_missed(seed: int, d: int, miss: float) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-5, 5, (10, d))
    block, poses = seen_block(places, 15, 0.0, rng)
    block[rng.random(block.shape[:2]) < miss] = np.nan
    relative = completed(block, reference_of(places, slice(0, 6)))
    np.testing.assert_allclose(relative.positions, places[relative.landmarks], atol=1e-7)
    assert np.nan_to_num(relative.variance).max(initial=0.0) < 1e-12
    for k in np.flatnonzero(relative.used.any(axis=0)):
        np.testing.assert_allclose(relative.R[k], poses[k][0], atol=1e-7)
        np.testing.assert_allclose(relative.t[k], poses[k][1], atol=1e-6)


@both_dimensions
def test_observations_outside_the_common_interval_make_it_better(d: int) -> None:
    rng = np.random.default_rng(d)
    places = rng.uniform(-5, 5, (9, d))
    common: list[float] = []
    everything: list[float] = []
    for _ in range(300):
        block, _ = seen_block(places, 40, 0.05, rng)
        block[4, 10:] = np.nan  # the common interval of all members is a quarter of the time
        reference = reference_of(places, slice(0, 5))
        for errors, seen in ((common, block[:, :10]), (everything, block)):
            relative = completed(seen, reference)
            errors.append(float(np.sum((relative.positions[8] - places[8]) ** 2)))
    # Four times the observations, and in three quarters of them one member fewer to fit to.
    assert 0.45 < np.sqrt(np.mean(everything) / np.mean(common)) < 0.6


@both_dimensions
@pytest.mark.parametrize("members", [4, 8])
def test_amplified_is_the_variance_that_the_fit_leads_to(d: int, members: int) -> None:
    rng = np.random.default_rng(members)
    outside = np.zeros((3, d))
    outside[1] = 3.0
    outside[2, 0] = 20.0
    places = np.vstack([rng.uniform(-5, 5, (members, d)), outside])
    block, _ = seen_block(places, 8000, 0.01, rng)
    relative = completed(block, reference_of(places, slice(0, members)))
    measured = relative.variance / 0.01**2
    np.testing.assert_allclose(measured[members:], relative.amplified[members:], rtol=0.05)
    # A member pulls the fit to itself.
    assert (measured[:members] < relative.amplified[:members]).all()


@both_dimensions
def test_amplified_accounts_for_iterations_with_few_members(d: int) -> None:
    rng = np.random.default_rng(d)
    outside = np.zeros((1, d))
    outside[0, 0] = 15.0
    places = np.vstack([rng.uniform(-5, 5, (10, d)), outside])
    block, _ = seen_block(places, 8000, 0.01, rng)
    block[3:10, ::4] = np.nan  # three members in every fourth iteration, ten in the others
    relative = completed(block, reference_of(places, slice(0, 10)))
    assert relative.variance[10] / 0.01**2 == pytest.approx(relative.amplified[10], rel=0.1)


@settings(max_examples=30)
@given(seeds, dimensions, st.integers(1, 6))
def test_the_variance_leaves_out_the_observation_farthest_off(seed: int, d: int, i: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-5, 5, (6, d))
    block, poses = seen_block(places, i, 0.0, rng)
    offsets = rng.standard_normal((i, d))
    for k, (R, _) in enumerate(poses):
        block[5, k] += offsets[k] @ R
    relative = completed(block, reference_of(places, slice(0, 5)))
    squares = np.sort(np.sum((offsets - offsets.mean(axis=0)) ** 2, axis=1))[:-1]
    expected = squares.sum() / (d * (i - 2)) if i > 2 else np.nan
    assert relative.variance[5] == pytest.approx(expected, nan_ok=True)


@both_dimensions
def test_the_variance_of_one_that_moves_is_that_of_its_motion(d: int) -> None:
    rng = np.random.default_rng(d)
    places = rng.uniform(-5, 5, (12, d))
    block, poses = seen_block(places, 200, 0.0, rng)
    way = 0.01 * np.arange(200)
    for k, (R, _) in enumerate(poses):
        block[11, k] += way[k] * R[0]  # along x
    relative = completed(block, reference_of(places, slice(0, 8)))
    assert relative.variance[11] == pytest.approx(way.var() / d, rel=0.05)
    assert relative.variance[:11].max() < 1e-12


def test_iterations_that_the_reference_does_not_fix_are_left_out() -> None:
    rng = np.random.default_rng(0)
    places = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 3, 0], [4, 4, 4]])
    block, _ = seen_block(places, 6, 0.0, rng)
    block[3, :2] = np.nan  # a line of three is left
    block[1:4, 2] = np.nan  # a single member is left
    relative = completed(block, reference_of(places, slice(0, 4)))
    assert relative.used[4].tolist() == [False, False, False, True, True, True]


@both_dimensions
def test_an_insufficient_reference_gives_an_empty_map(d: int) -> None:
    places = np.zeros((5, d))
    places[:, 0] = np.arange(5.0) if d == 3 else 0.0  # a line, or one spot
    places[4, -1] = 2.0
    block = np.repeat(places[:, None], 4, axis=1)
    relative = completed(block, reference_of(places, slice(0, 4)))
    assert relative.landmarks.tolist() == []


@both_dimensions
def test_only_keeps_rows_and_nothing_else_changes(d: int) -> None:
    rng = np.random.default_rng(d)
    places = rng.uniform(-5, 5, (7, d))
    relative = completed(seen_block(places, 5, 0.05, rng)[0], reference_of(places, slice(0, 5)))
    rows = np.array([True, False, True, True, False, False, True])
    part = relative.only(rows)
    for field in fields(relative):
        before, after = getattr(relative, field.name), getattr(part, field.name)
        of_iterations = field.name in ("iterations", "R", "t", "common_interval", "given")
        np.testing.assert_array_equal(after, before if of_iterations else before[rows])
