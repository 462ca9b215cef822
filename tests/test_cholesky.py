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
    for unknown, entry in zip(unknowns, np.diag(dense), strict=True):
        pattern.add(values, np.array([unknown]), np.array([[entry]]))
    for pair, entry in zip(pairs, dense[row, column], strict=True):
        pattern.add(values, pair, np.array([[0.0, entry], [entry, 0.0]]))
    order = np.argsort(unknowns)
    right = rng.normal(size=n * q)
    pattern.factorise(values)
    np.testing.assert_allclose(
        pattern.solve(values, right[order]), np.linalg.solve(dense, right)[order]
    )
    inverse, expected = pattern.inverse(values), np.linalg.inv(dense)
    own = [expected[i * q : (i + 1) * q, i * q : (i + 1) * q] for i in range(n)]
    np.testing.assert_allclose(pattern.parts(inverse, unknowns.reshape(n, q)), own, atol=1e-12)
    np.testing.assert_allclose(
        pattern.parts(inverse, pairs)[:, 0, 1], expected[row, column], atol=1e-12
    )
