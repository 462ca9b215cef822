from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from relmap import RelmapError
from relmap.core.geometry.alignment import fit_rigid, fixes_rotation
from tests.worlds import random_rotation

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])


@given(seeds, dimensions, st.integers(3, 30))
def test_recovers_the_motion_exactly(seed: int, d: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(0, 5, (n, d))
    R, t = random_rotation(d, np.pi, rng), rng.normal(0, 100, d)
    fitted_R, fitted_t = fit_rigid(source, source @ R.T + t, rng.uniform(0.1, 3, n))
    np.testing.assert_allclose(fitted_R, R, atol=1e-9)
    np.testing.assert_allclose(fitted_t, t, atol=1e-9)


@given(seeds, dimensions)
def test_never_reflects(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(0, 1, (6, d))
    mirrored = source * np.array([-1.0, *([1.0] * (d - 1))])
    R, _ = fit_rigid(source, mirrored + rng.normal(0, 0.1, source.shape))
    np.testing.assert_allclose(R @ R.T, np.eye(d), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)


@given(seeds)
def test_agrees_with_scipy_under_noise_and_weights(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, weights = rng.normal(0, 5, (8, 3)), rng.uniform(0.1, 3, 8)
    target = source @ random_rotation(3, 1.0, rng).T + rng.normal(0, 0.5, source.shape)
    R, t = fit_rigid(source, target, weights)
    share = weights / weights.sum()
    a, b = share @ source, share @ target
    expected, _ = Rotation.align_vectors(target - b, source - a, weights)
    np.testing.assert_allclose(R, expected.as_matrix(), atol=1e-7)
    np.testing.assert_allclose(t, b - expected.apply(a), atol=1e-6)


def test_a_point_without_weight_does_not_count() -> None:
    source = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0], [9.0, 9.0]])
    target = source + np.array([1.0, 2.0])
    target[3] = [-50.0, 7.0]
    R, t = fit_rigid(source, target, np.array([1.0, 1.0, 1.0, 0.0]))
    np.testing.assert_allclose(R, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(t, [1.0, 2.0], atol=1e-12)


@pytest.mark.parametrize(
    ("source", "target", "weights"),
    [
        (np.zeros((3, 3)), np.zeros((4, 3)), None),
        (np.zeros((3, 4)), np.zeros((3, 4)), None),
        (np.zeros((0, 3)), np.zeros((0, 3)), None),
        (np.zeros((3, 3)), np.full((3, 3), np.nan), None),
        (np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)),
        (np.zeros((3, 3)), np.zeros((3, 3)), np.ones(2)),
    ],
)
def test_invalid_input_is_refused(
    source: np.ndarray, target: np.ndarray, weights: np.ndarray | None
) -> None:
    with pytest.raises(RelmapError, match="rigid fit"):
        fit_rigid(source, target, weights)


@pytest.mark.parametrize(
    ("points", "fixed"),
    [
        ([[0, 0], [1, 0]], True),
        ([[1, 1], [1, 1]], False),
        ([[1, 1]], False),
        ([[0, 0, 0], [1, 1, 1], [3, 3, 3]], False),
        ([[0, 0, 0], [1, 1, 1], [3, 3, 2]], True),
        ([[0, 0, 0], [1, 1, 1]], False),
    ],
)
def test_which_points_determine_a_rotation(points: list[list[float]], fixed: bool) -> None:
    assert fixes_rotation(np.array(points, dtype=float)) is fixed
