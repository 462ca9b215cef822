"""The compiled loops, compared with numpy and scipy."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats, Ints
from relmap.core.association import matching_kernels, tracking_kernels
from relmap.core.geometry import fitting_kernels, rotation_kernels
from relmap.core.geometry.alignment import fit_rigid, rotation_of_moment
from relmap.core.grouping import binning_kernels
from relmap.core.grouping.averaging_kernels import steady_variance
from relmap.core.grouping.chart_kernels import chart_block, seen_with
from relmap.core.grouping.dynamics import FEWEST
from relmap.core.linalg import small_kernels
from relmap.core.refinement.live_kernels import united
from tests.kernels import callable_here
from tests.worlds import random_rotation

claims = callable_here(matching_kernels.claims)
buckets = callable_here(matching_kernels.buckets)
nearest_to = callable_here(matching_kernels.nearest_to)
matched = callable_here(matching_kernels.matched)
continued = callable_here(tracking_kernels.continued)
three_nearest = callable_here(matching_kernels.three_nearest)
three_within = callable_here(matching_kernels.three_within)
nearest_of_sample = callable_here(matching_kernels.nearest_of_sample)
fit_rows = callable_here(fitting_kernels.fit_rows)
best_rotation = callable_here(rotation_kernels.best_rotation)
keeps_distance = callable_here(binning_kernels.keeps_distance)
inverse3 = callable_here(small_kernels.inverse3)

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
sizes = st.integers(0, 40)
Points = Floats


def distances(queries: Points, points: Points) -> Points:
    return np.asarray(np.linalg.norm(queries[:, None] - points, axis=2))


# Matching.


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


# Rotations.


def moment_of(source: Points, target: Points) -> Points:
    centred: Points = source - source.mean(axis=0)
    return np.asarray(centred.T @ (target - target.mean(axis=0)))


@settings(max_examples=200)
@given(seeds, st.integers(3, 12), st.floats(0, 3), st.booleans(), st.sampled_from([1, 1e-6, 1e6]))
def test_the_best_rotation_is_scipys(
    seed: int, n: int, noise: float, mirrored: bool, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(0, 1, (n, 3))
    target = source @ random_rotation(3, np.pi, rng).T + noise * rng.normal(0, 1, (n, 3))
    if mirrored:
        target[:, 0] *= -1
    moment = moment_of(source, target)
    found = best_rotation(scale * moment, random_rotation(3, np.pi, rng))
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(found) == pytest.approx(1)
    best, _ = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))
    # The trace is what is maximised: where two rotations are as good, either will do.
    trace, expected = np.trace(found @ moment), np.trace(best.as_matrix() @ moment)
    assert trace == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(moment).max())
    u, v, w = np.linalg.svd(moment)[1]
    if v + np.sign(np.linalg.det(moment)) * w > 1e-3 * u:
        np.testing.assert_allclose(found, best.as_matrix(), atol=1e-6)


@settings(max_examples=60)
@given(seeds, st.sampled_from(["plane", "mirrored plane", "line", "spot", "half a turn"]))
def test_the_best_rotation_of_degenerate_points_is_a_proper_one_and_as_good_as_any(
    seed: int, kind: str
) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(0, 1, (8, 3))
    R = random_rotation(3, np.pi, rng)
    if kind == "half a turn":
        R = np.diag([1.0, -1.0, -1.0])
    elif kind == "spot":
        source[:] = source[0]
    else:
        source[:, 1 if kind == "line" else 2 :] = 0.0
    target = source @ R.T
    if kind == "mirrored plane":
        target = source * [-1, 1, 1] @ R.T
    moment = moment_of(source, target)
    found = best_rotation(moment, np.eye(3))
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(found) == pytest.approx(1)
    assert np.trace(found @ moment) == pytest.approx(np.linalg.svd(moment)[1].sum(), abs=1e-9)


@given(seeds)
def test_the_best_rotation_in_the_plane_is_that_of_the_decomposition(seed: int) -> None:
    moment = np.random.default_rng(seed).normal(0, 3, (2, 2))
    found = best_rotation(moment, np.eye(2))
    np.testing.assert_allclose(found, rotation_of_moment(moment), atol=1e-9)
    np.testing.assert_array_equal(best_rotation(np.zeros((2, 2)), np.eye(2)), np.eye(2))


@given(seeds)
def test_the_inverse_is_numpys_and_knows_what_is_positive(seed: int) -> None:
    A = np.random.default_rng(seed).normal(0, 1, (3, 3))
    A += A.T
    inverse = np.empty((3, 3))
    positive = inverse3(A, inverse)
    np.testing.assert_allclose(inverse @ A, np.eye(3), atol=1e-6)
    assert positive == (np.linalg.eigvalsh(A)[0] > 0)


@given(seeds, dimensions, st.integers(4, 20))
def test_the_fit_of_some_rows_is_the_fit_of_these_alone(seed: int, d: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    source, target = rng.normal(0, 5, (n, d)), rng.normal(0, 5, (n, d))
    target[: n // 2] = source[: n // 2]
    rows = rng.permutation(n) < max(4, n // 2)
    R, t, fixed, scatter, _ = fit_rows(source, target, rows, np.eye(d))
    expected_R, expected_t = fit_rigid(source[rows], target[rows])
    there, expected = source[rows] @ R.T + t, source[rows] @ expected_R.T + expected_t
    squares, least = (np.sum((at - target[rows]) ** 2) for at in (there, expected))
    assert squares == pytest.approx(least, rel=1e-9, abs=1e-9)
    expected_scatter = moment_of(source[rows], source[rows])
    np.testing.assert_allclose(scatter[:d, :d], expected_scatter, atol=1e-9)
    assert fixed


# Noise, distances and charts.


@settings(max_examples=60)
@given(seeds, dimensions, st.integers(3, 15), st.integers(2, 20), st.integers(0, 2))
def test_steady_variance_is_numpys(seed: int, d: int, g: int, m: int, movers: int) -> None:
    rng = np.random.default_rng(seed)
    block = rng.uniform(-5, 5, (g, 1, d)) + 0.1 * rng.standard_normal((g, m, d))
    block[:movers] += np.arange(m)[:, None]
    inner = np.ones(g, dtype=bool)
    for _ in range(3):
        radius = np.linalg.norm(block - block[inner].mean(axis=0), axis=2)
        h = inner.sum()
        scale = np.where(inner, h / (h - 1), h / (h + 1))
        variance = radius.var(axis=1, ddof=1) * scale
        inner = np.isin(np.arange(g), np.argsort(variance, kind="stable")[: max(3, (g + 1) // 2)])
    assert steady_variance(block, 0.9) == pytest.approx(np.median(variance) / 0.9)


@given(seeds, dimensions, st.integers(0, 12))
def test_a_distance_is_kept_where_its_variance_is_within_the_limit(
    seed: int, d: int, m: int
) -> None:
    rng = np.random.default_rng(seed)
    block = rng.normal(0, 1, (2, m, d))
    block[rng.random((2, m)) < 0.3] = np.nan
    apart = np.linalg.norm(block[0] - block[1], axis=1)
    apart = apart[np.isfinite(apart)]
    variance = apart.var(ddof=1) if len(apart) > 1 else 0.0
    for limit in (0.9 * variance, 1.1 * variance + 1e-12):
        kept = len(apart) >= FEWEST and variance <= limit
        assert keeps_distance(block, 0, 1, limit) == kept
        assert keeps_distance(block, 1, 0, limit) == kept


@given(seeds, dimensions, st.integers(1, 8), st.integers(0, 10), st.floats(0, 1))
def test_a_chart_shows_everything_seen_with_the_seed(
    seed: int, d: int, n: int, m: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    visible = rng.random((m, n)) < share
    table = np.where(visible[:, :, None], rng.normal(0, 1, (m, n, d)), np.nan)
    orders = [rng.permutation(np.flatnonzero(row)) for row in visible]
    landmarks = np.concatenate([*orders, np.empty(0, dtype=np.int64)])
    offsets = np.concatenate([[0], np.cumsum([len(order) for order in orders])]).astype(np.int64)
    points = np.empty((len(landmarks), d))
    for k, (a, b) in enumerate(pairwise(offsets.tolist())):
        points[a:b] = table[k, orders[k]]
    slots = np.full(n, -1)
    members, columns = seen_with(landmarks, offsets, 0, slots)
    block = chart_block(landmarks, points, offsets, members, columns, slots)
    when = np.flatnonzero(visible[:, 0])
    others = np.flatnonzero(visible[when, 1:].any(axis=0)) + 1
    assert members[0] == 0
    assert sorted(members.tolist()) == [0, *others.tolist()]
    np.testing.assert_array_equal(columns, when)
    np.testing.assert_array_equal(block, table[when].transpose(1, 0, 2)[members])
    assert (slots == -1).all()
