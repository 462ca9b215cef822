"""The compiled loops, compared with numpy and scipy."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.core.geometry import fitting_kernels, rotation_kernels
from relmap.core.geometry.alignment import fit_rigid, rotation_of_moment
from relmap.core.grouping import binning_kernels
from relmap.core.grouping.averaging_kernels import steady_variance
from relmap.core.grouping.chart_kernels import chart_block, seen_with
from relmap.core.grouping.dynamics import FEWEST
from relmap.core.linalg import small_kernels
from tests.kernels import callable_here
from tests.worlds import random_rotation

fit_rows = callable_here(fitting_kernels.fit_rows)
best_rotation = callable_here(rotation_kernels.best_rotation)
keeps_distance = callable_here(binning_kernels.keeps_distance)
inverse3 = callable_here(small_kernels.inverse3)

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
Points = Floats


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
