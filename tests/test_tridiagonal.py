from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap.core.linalg.tridiagonal import Levels, factor


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 5))
def test_levels_solve_and_invert_as_dense_matrices_do(seed: int, q: int, depth: int) -> None:
    rng = np.random.default_rng(seed)
    level = rng.permutation(np.concatenate([np.arange(depth), rng.integers(0, depth, 6)]))
    levels = Levels(level, q)
    near = np.abs(level[:, None] - level) <= 1
    dense = np.where(np.kron(near, np.ones((q, q))), rng.normal(size=(len(level) * q,) * 2), 0.0)
    dense = dense + dense.T + 40 * np.eye(len(dense))
    buffer = np.zeros(levels.size)
    at = np.argsort(level, kind="stable")
    unknowns = (at[:, None] * q + np.arange(q)).ravel()
    ordered, begin = dense[np.ix_(unknowns, unknowns)], np.cumsum(levels.widths) - levels.widths
    for (diagonal, below), a, w in zip(levels.blocks(buffer), begin, levels.widths, strict=True):
        diagonal[:] = ordered[a : a + w, a : a + w]
        below[:] = ordered[a + w : a + w + len(below), a : a + w]
    found, right = factor(levels, buffer), rng.normal(size=(len(level), q))
    np.testing.assert_allclose(found.solve(right).ravel(), np.linalg.solve(dense, right.ravel()))
    inverse = np.linalg.inv(dense)
    own = [inverse[i * q : (i + 1) * q, i * q : (i + 1) * q] for i in range(len(level))]
    np.testing.assert_allclose(levels.diagonal(found.inverse()), own, atol=1e-12)
    ordered = inverse[np.ix_(unknowns, unknowns)]
    for (_, below), a, w in zip(levels.blocks(found.inverse()), begin, levels.widths, strict=True):
        np.testing.assert_allclose(
            below, ordered[a + w : a + w + len(below), a : a + w], atol=1e-12
        )


def test_a_matrix_that_is_not_positive_is_refused() -> None:
    levels = Levels(np.zeros(2, dtype=np.int64), 1)
    with pytest.raises(np.linalg.LinAlgError):
        factor(levels, np.array([1.0, 0.0, 0.0, -1.0]))
