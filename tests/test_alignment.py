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
    fitted_R, fitted_t = fit_rigid(source, source @ R.T + t)
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
def test_agrees_with_scipy_under_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(0, 5, (8, 3))
    target = source @ random_rotation(3, 1.0, rng).T + rng.normal(0, 0.5, source.shape)
    R, t = fit_rigid(source, target)
    a, b = source.mean(axis=0), target.mean(axis=0)
    expected, _ = Rotation.align_vectors(target - b, source - a)
    np.testing.assert_allclose(R, expected.as_matrix(), atol=1e-7)
    np.testing.assert_allclose(t, b - expected.apply(a), atol=1e-6)


@pytest.mark.parametrize(
    ("source", "target"),
    [
        (np.zeros((3, 3)), np.zeros((4, 3))),
        (np.zeros((3, 4)), np.zeros((3, 4))),
        (np.zeros((0, 3)), np.zeros((0, 3))),
        (np.zeros((3, 3)), np.full((3, 3), np.nan)),
    ],
)
def test_invalid_input_is_refused(source: np.ndarray, target: np.ndarray) -> None:
    with pytest.raises(RelmapError, match="rigid fit"):
        fit_rigid(source, target)


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
