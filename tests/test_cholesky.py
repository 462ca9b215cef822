"""Sparse Cholesky in levels; sums of cliques are tested with the walls that use them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap.core.linalg.cholesky import Pattern


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 5), st.sampled_from([6, 60, 200])
)
def test_levels_solve_and_invert_as_dense_matrices_do(
    seed: int, q: int, depth: int, more: int
) -> None:
    rng = np.random.default_rng(seed)
    level = rng.permutation(np.concatenate([np.arange(depth), rng.integers(0, depth, more)]))
    pattern, n = Pattern.of_levels(level, q), len(level)
    near = np.kron(np.abs(level[:, None] - level) <= 1, np.ones((q, q), dtype=bool))
    dense = np.where(near, rng.normal(size=(n * q,) * 2), 0.0)
    dense = dense + dense.T + 40 * (1 + more) / 7 * np.eye(n * q)
    unknowns = (pattern.first[:, None] + np.arange(q)).ravel()
    row, column = np.nonzero(near & (unknowns[:, None] > unknowns))
    pairs = np.column_stack([unknowns[column], unknowns[row]])
    values = np.zeros(pattern.size)
    at = pattern.entries(2 * np.arange(len(pairs) + 1), pairs.ravel()).reshape(-1, 3)
    values[at] = np.column_stack([dense[column, column], dense[row, column], dense[row, row]])
    if not len(pairs):
        values[:] = dense.ravel()
    right = rng.normal(size=(n, q))
    pattern.factorise(values)
    np.testing.assert_allclose(
        pattern.solve(values, right).ravel(), np.linalg.solve(dense, right.ravel())
    )
    inverse, expected = pattern.inverse(values), np.linalg.inv(dense)
    own = [expected[i * q : (i + 1) * q, i * q : (i + 1) * q] for i in range(n)]
    np.testing.assert_allclose(pattern.diagonal(inverse, q), own, atol=1e-12)
    np.testing.assert_allclose(inverse[at[:, 1]], expected[row, column], atol=1e-12)


def test_a_factor_made_in_lots_is_the_same() -> None:
    rng = np.random.default_rng(0)
    level = np.repeat(np.arange(9), 40)
    pattern = Pattern.of_levels(level, 2)
    values = 0.01 * rng.normal(size=pattern.size)
    pattern.hold(values, 0.0, 10.0)
    other = values.copy()
    pattern.factorise(values)
    lots = sum(1 for _ in pattern.factorised(other, pattern.flops / 7))
    assert 5 < lots < 12
    np.testing.assert_array_equal(other, values)
