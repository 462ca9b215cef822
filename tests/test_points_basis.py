from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from relmap.points import basis_kernels
from relmap.points.model import PointModel
from tests.kernels import callable_here
from tests.worlds import aligned_rmse, random_rotation

choose_basis = callable_here(basis_kernels.choose_basis)
into_basis = callable_here(basis_kernels.into_basis)
seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])


def moved_block(seed: int, d: int, sigma: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return a constellation (g, d) and a block (g, i, d) of it seen from ten poses."""
    rng = np.random.default_rng(seed)
    shape = rng.normal(0, 5, (7, d))
    views = [shape @ random_rotation(d, 3.0, rng).T + rng.normal(0, 20, d) for _ in range(10)]
    block = np.stack(views, axis=1)
    return shape, block + sigma * rng.normal(size=block.shape)


@given(seeds, dimensions)
def test_basis_points_stand_where_the_paper_puts_them(seed: int, d: int) -> None:
    _, block = moved_block(seed, d, sigma=0.1)
    basis = choose_basis(block[:, 5])
    assert len(basis) == d
    placed = into_basis(block, basis)
    np.testing.assert_allclose(placed[basis[0]], 0, atol=1e-9)
    np.testing.assert_allclose(placed[basis[1]][:, 1:], 0, atol=1e-9)
    assert (placed[basis[1]][:, 0] < 0).all()
    if d == 3:
        np.testing.assert_allclose(placed[basis[2]][:, 1], 0, atol=1e-9)
        assert (placed[basis[2]][:, 2] > 0).all()


@given(seeds, dimensions)
def test_the_basis_keeps_shape_and_handedness(seed: int, d: int) -> None:
    shape, block = moved_block(seed, d)
    basis = choose_basis(block[:, 0])
    assert len(basis) == d
    for view in np.swapaxes(into_basis(block, basis), 0, 1):
        assert aligned_rmse(view, shape) < 1e-9


@given(seeds, dimensions)
def test_relative_map_is_exact_without_noise(seed: int, d: int) -> None:
    shape, block = moved_block(seed, d)
    relative = PointModel().average_in_basis(block)
    assert aligned_rmse(relative, shape) < 1e-9


def test_relative_map_averages_the_noise_away() -> None:
    errors = []
    for seed in range(200):
        shape, block = moved_block(seed, 3, sigma=0.01)
        relative = PointModel().average_in_basis(block)
        errors.append(aligned_rmse(relative, shape))
    # 7 points have 21 coordinates, of which an alignment takes 6 away; ten views are averaged.
    expected = 0.01 * np.sqrt((21 - 6) / 7 / 10)
    assert np.sqrt(np.mean(np.square(errors))) < 1.15 * expected


def test_basis_points_are_spread_apart() -> None:
    points = np.array(
        [[0, 0, 0], [0.1, 0, 0], [10, 0, 0], [10.1, 0.1, 0], [5, 4, 0], [5, 0.3, 0.0]]
    )
    basis = choose_basis(points)
    assert set(basis.tolist()) == {0, 3, 4}


def test_collinear_points_determine_no_basis_in_space() -> None:
    line = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    assert len(choose_basis(line)) == 0
    assert PointModel().average_in_basis(np.stack([line, line + 1], axis=1)) is None


def test_a_basis_that_collapses_in_one_iteration_is_refused() -> None:
    shape = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0], [1, 1, 1]])
    block = np.stack([np.zeros_like(shape), shape, shape], axis=1)
    assert PointModel().average_in_basis(block) is None
