"""The compiled loops that match points, compared with k-d trees and plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats, Ints
from relmap.core.association import matching_kernels, tracking_kernels
from relmap.core.association.search_kernels import placements_by_triangles
from relmap.core.refinement.live_kernels import united
from tests.kernels import callable_here

claims = callable_here(matching_kernels.claims)
buckets = callable_here(matching_kernels.buckets)
nearest_to = callable_here(matching_kernels.nearest_to)
matched = callable_here(matching_kernels.matched)
continued = callable_here(tracking_kernels.continued)
three_nearest = callable_here(matching_kernels.three_nearest)
three_within = callable_here(matching_kernels.three_within)
nearest_of_sample = callable_here(matching_kernels.nearest_of_sample)

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
sizes = st.integers(0, 40)
Points = Floats


def distances(queries: Points, points: Points) -> Points:
    return np.asarray(np.linalg.norm(queries[:, None] - points, axis=2))


def nearest_within(points: Points, queries: Points, reach: float) -> tuple[Points, Ints]:
    grid, apart = buckets(points, reach, reach), np.empty(points.shape[1])
    found = [nearest_to(query, points, grid, None, apart) for query in queries]
    square, index = np.array(found).reshape(-1, 2).T
    return np.where(index < len(points), np.sqrt(square), np.inf), index.astype(np.int64)


@given(seeds, dimensions, sizes, sizes, st.floats(0.01, 30))
def test_nearest_within_is_what_a_tree_finds(
    seed: int, d: int, n: int, k: int, reach: float
) -> None:
    rng = np.random.default_rng(seed)
    points, queries = rng.normal(0, 5, (n, d)), rng.normal(0, 5, (k, d))
    distance, index = nearest_within(points, queries, reach)
    assert len(distance) == len(index) == k
    if n and k:
        expected, at = cKDTree(points).query(queries, distance_upper_bound=reach)
        np.testing.assert_array_equal(index, at)
        np.testing.assert_allclose(distance, expected, rtol=1e-12)
    else:
        assert np.isinf(distance).all()
        assert (index == n).all()


@given(seeds, dimensions, sizes, sizes, st.sampled_from([1, 2, 3]))
def test_of_equally_near_points_the_first_is_found_and_the_edge_counts(
    seed: int, d: int, n: int, k: int, reach: int
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.integers(-3, 4, (n, d)).astype(float)  # whole numbers: many ties, no rounding
    queries = rng.integers(-3, 4, (k, d)).astype(float)
    distance, index = nearest_within(points, queries, float(reach))
    apart = np.column_stack([distances(queries, points), np.full(k, np.inf)])
    apart[apart > reach] = np.inf
    expected = np.where(np.isfinite(apart.min(axis=1)), apart.argmin(axis=1), n)
    np.testing.assert_array_equal(index, expected)
    np.testing.assert_array_equal(distance, apart.min(axis=1))


@both_dimensions
def test_nearest_within_any_reach(d: int) -> None:
    points = np.random.default_rng(d).normal(0, 5, (20, d))
    distance, index = nearest_within(points, points + 1.0, np.inf)
    np.testing.assert_array_equal(index, distances(points + 1.0, points).argmin(axis=1))
    np.testing.assert_allclose(distance, distances(points + 1.0, points).min(axis=1))


@given(seeds, dimensions, st.integers(0, 300), st.sampled_from([0.0, 0.3, 1.0, 2.0, np.inf]))
def test_the_three_nearest_within_a_radius_are_those_of_all_points(
    seed: int, d: int, n: int, radius: float
) -> None:
    rng = np.random.default_rng(seed)
    points, queries = rng.normal(0, 4, (n, d)), rng.normal(0, 4, (9, d))
    if seed % 2:
        points, queries = points.round(), queries.round()  # many ties, and points at one place
    grid = buckets(points, radius, radius / 2)
    for query in queries:
        *near, index = three_within(query, points, grid, radius)
        *nearest, first = three_nearest(points, query)
        within = np.array(nearest) <= radius**2
        np.testing.assert_array_equal(np.array(near)[within], np.array(nearest)[within])
        assert (np.array(near)[~within] > radius**2).all()
        assert index == first or not within[0]


@given(seeds, dimensions, sizes, sizes, st.integers(1, 9), st.booleans())
def test_the_nearest_of_a_sample_of_the_tracks_seen_last(
    seed: int, d: int, n: int, m: int, most: int, ties: bool
) -> None:
    rng = np.random.default_rng(seed)
    points, tracks = rng.normal(0, 2, (n, d)), rng.normal(0, 2, (m + 1, d))
    if ties:
        points, tracks = points.round(), tracks.round()
    missed = rng.integers(0, 3, m + 1)
    sample, target, distance, spacing = nearest_of_sample(points, tracks, missed, most, np.inf)
    latest = np.flatnonzero(missed == missed.min())
    if min(n, len(latest)) < 2:
        assert not len(sample)
        return
    np.testing.assert_array_equal(sample, latest[:: -(-len(latest) // most)])
    apart = distances(tracks[sample], points)
    np.testing.assert_array_equal(target, apart.argmin(axis=1))
    np.testing.assert_allclose(distance, apart.min(axis=1), rtol=1e-12)
    crowd = points if n >= len(latest) else tracks[latest]
    neighbours = crowd[:: -(-len(crowd) // most)]
    second, third = np.sort(distances(neighbours, crowd), axis=1)[:, 1:3].T[[0, -1]]
    expected = np.sort(second)[len(second) // 2]
    if len(crowd) >= matching_kernels.MANY:  # They may be pairs.
        expected = max(expected, np.sort(third)[len(third) // 4] / matching_kernels.PAIR_RATIO)
    np.testing.assert_allclose(spacing, expected, rtol=1e-12)


@given(seeds, dimensions, sizes, sizes)
def test_tracks_are_continued_where_expected_or_else_where_seen_last(
    seed: int, d: int, n: int, m: int
) -> None:
    rng = np.random.default_rng(seed)
    points, latest = rng.normal(0, 2, (n, d)), rng.normal(0, 2, (m, d))
    missed, restless = rng.integers(0, 2, m), rng.integers(0, 2, m)
    seen = rng.integers(1, 5, m)
    near, young = (1.5, 0.7), 3
    distance, target = nearest_within(points, latest + 0.1, 0.3)
    counts, reaches, linked = (missed, seen, restless), (*near, young), claims(target, distance, n)
    match, grid = np.empty(m, dtype=np.int64), buckets(points, 0.3, 0.3)
    assert matched(latest + 0.1, points, grid, None, match) == linked.sum()
    np.testing.assert_array_equal(match, np.where(linked, target, -1))
    rows, found, n_static = continued(points, match, latest, counts, grid, reaches)
    np.testing.assert_array_equal(rows[:n_static], np.flatnonzero(linked))
    np.testing.assert_array_equal(found[:n_static], target[linked])
    wanted, apart = np.full(m, n), np.full(m, np.inf)
    for row in np.flatnonzero(~linked & (missed == 0)) if n else ():
        away = distances(latest[row : row + 1], points)[0]
        reach = near[0] if restless[row] or seen[row] < young else near[1]
        if away.min() <= reach and away.argmin() not in target[linked]:
            wanted[row], apart[row] = away.argmin(), away.min()
    moving = claims(wanted, apart, n)
    np.testing.assert_array_equal(rows[n_static:], np.flatnonzero(moving))
    np.testing.assert_array_equal(found[n_static:], wanted[moving])


@given(
    st.lists(st.tuples(st.integers(0, 4), st.sampled_from([0.0, 1.0, 2.0, np.inf])), max_size=15)
)
def test_claims_go_to_the_nearest_and_of_equals_to_the_first(
    wishes: list[tuple[int, float]],
) -> None:
    wanted = np.array([wish[0] for wish in wishes], dtype=np.int64)
    distance = np.array([wish[1] for wish in wishes])
    won = claims(wanted, distance, 5)
    for target in range(5):
        rows = [row for row, wish in enumerate(wishes) if wish[0] == target and wish[1] < np.inf]
        nearest = min(rows, key=lambda row: (distance[row], row), default=None)
        assert [row for row in rows if won[row]] == ([] if nearest is None else [nearest])
    assert not won[np.isinf(distance)].any()


@given(seeds, sizes, sizes)
def test_the_landmarks_of_two_lists_are_united(seed: int, n: int, m: int) -> None:
    listed = np.random.default_rng(seed).integers(0, 30, n + m)
    landmark, of, both = united(listed, listed.argsort(kind="stable"), n)
    expected, at = np.unique(listed, return_inverse=True)
    np.testing.assert_array_equal(landmark, expected)
    np.testing.assert_array_equal(of, at)
    last = [{int(listed[i]): i for i in rows} for rows in (range(n), range(n, n + m))]
    shared = [one for one in expected.tolist() if one in last[0] and one in last[1]]
    places = [[rows[one] for one in shared] for rows in last]
    np.testing.assert_array_equal(both, np.array(places).reshape(2, -1))


@both_dimensions
def test_triangles_of_targets_that_coincide_fit_nothing_in_any_metric(d: int) -> None:
    source, target, tolerance_m = np.zeros((3, d)), np.zeros((3, d)), 0.1
    source[1, :2], source[2, :2] = (4.0, 3.0), (4.0, -3.0)
    target[1:, 0] = 5.0
    for metric in (None, np.tile(np.eye(d), (3, 1, 1))):
        found = placements_by_triangles(
            source, target, np.arange(3)[None], tolerance_m, 0, metric, tolerance_m
        )
        assert not len(found[0])
