"""Sparse Cholesky of sums of cliques, against dense matrices."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.cholesky import Pattern
from relmap.core.linalg.cholesky_kernels import add_part

Cliques = tuple[Pattern, list[Ints]]


def add(pattern: Pattern, values: Floats, unknowns: Ints, part: Floats) -> None:
    """Add a symmetric part (n, n) over coupled unknowns (n,), ascending, to a matrix."""
    add_part(pattern.layout, unknowns, part, values, np.empty_like(pattern.layout[1]))


def cliques_of(rng: np.random.Generator, blocks: int) -> Cliques:
    """Return a pattern of random cliques, and the unknowns of each."""
    width = rng.integers(1, 5, blocks)
    cliques = [np.unique(rng.integers(0, blocks, 4)) for _ in range(blocks)]
    cliques += [np.array([block]) for block in range(blocks)]
    sizes = np.cumsum([0] + [len(clique) for clique in cliques])
    pattern = Pattern.of_cliques(width, sizes, np.concatenate(cliques))
    unknowns = [
        np.sort(np.concatenate([pattern.first[b] + np.arange(width[b]) for b in clique]))
        for clique in cliques
    ]
    return pattern, unknowns


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_sums_of_cliques_are_solved_as_dense_matrices_are(seed: int, blocks: int) -> None:
    rng = np.random.default_rng(seed)
    pattern, unknowns = cliques_of(rng, blocks)
    n = 1 + max(int(part.max()) for part in unknowns)
    dense, values = np.zeros((n, n)), np.zeros(pattern.size)
    for part in unknowns:
        root = rng.normal(size=(len(part), len(part)))
        own = root @ root.T + 0.1 * np.eye(len(part))
        dense[np.ix_(part, part)] += own
        add(pattern, values, part, own)
    pattern.hold(values, 0.5, 0.25)
    dense[np.diag_indices(n)] *= 1.5
    dense[np.diag_indices(n)] += 0.25
    right = rng.normal(size=n)
    pattern.factorise(values)
    np.testing.assert_allclose(
        pattern.solve(values, right), np.linalg.solve(dense, right), rtol=1e-9, atol=1e-12
    )
    columns = np.eye(n)[:, rng.integers(0, n, 3)] - np.eye(n)[:, rng.integers(0, n, 3)]
    solved = np.linalg.solve(dense, columns)
    np.testing.assert_allclose(pattern.solve(values, columns), solved, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        pattern.products(values, columns),
        columns.T @ solved,
        rtol=1e-9,
        atol=1e-12,
    )


def test_a_path_is_eliminated_without_filling() -> None:
    n = 50
    pairs = np.column_stack([np.arange(n - 1), np.arange(1, n)])
    pairs = np.random.default_rng(0).permutation(n)[pairs]
    pattern = Pattern.of_cliques(np.ones(n, dtype=np.int64), 2 * np.arange(n), pairs.ravel())
    # The last two stand in one panel, a square.
    assert pattern.size == 2 * n


def test_couplings_over_a_long_way_are_in_the_pattern() -> None:
    n = 4000
    ring = np.column_stack([np.arange(n), (np.arange(n) + 1) % n])
    hub = np.column_stack([np.arange(n), np.full(n, n)])
    cliques = np.concatenate([ring, hub]).ravel()
    width = np.ones(n + 1, dtype=np.int64)
    pattern = Pattern.of_cliques(width, 2 * np.arange(2 * n + 1), cliques)
    start, panel_of, begin, rows, _ = pattern.layout
    panels = [set(rows[first:stop].tolist()) for first, stop in itertools.pairwise(begin)]
    for p, panel in enumerate(panels):
        below = {row for row in panel if row >= start[p + 1]}
        assert not below or below <= panels[panel_of[min(below)]]


def test_a_singular_pivot_leaves_its_unknown_unchanged() -> None:
    pattern = Pattern.of_cliques(np.array([2]), np.array([0, 1]), np.array([0]))
    values = np.zeros(pattern.size)
    add(pattern, values, np.arange(2), np.ones((2, 2)))
    pattern.factorise(values)
    np.testing.assert_allclose(pattern.solve(values, np.array([3.0, 3.0])), [3.0, 0.0], atol=1e-12)


def test_blocks_of_the_inverse() -> None:
    width, begin = np.array([2, 3, 1]), np.array([0, 2, 4])
    pattern = Pattern.of_cliques(width, begin, np.array([0, 1, 1, 2]))
    first, rng = pattern.first, np.random.default_rng(0)
    matrix, values = np.zeros((6, 6)), np.zeros(pattern.size)
    for blocks in ([0, 1], [1, 2]):
        own = np.sort(np.concatenate([first[b] + np.arange(width[b]) for b in blocks]))
        root = rng.normal(size=(len(own), len(own)))
        part = root @ root.T
        matrix[np.ix_(own, own)] += part
        add(pattern, values, own, part)
    chosen = np.array([[0, 3], [5, 3], [1, 4]])
    pattern.factorise(values)
    found = pattern.parts(pattern.inverse(values), chosen)
    expected = np.linalg.inv(matrix)[chosen[:, :, None], chosen[:, None, :]]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 5), st.sampled_from([6, 60, 200])
)
def test_bodies_along_a_path_solve_and_invert_as_dense_matrices_do(
    seed: int, q: int, depth: int, more: int
) -> None:
    rng = np.random.default_rng(seed)
    place = rng.permutation(np.concatenate([np.arange(depth), rng.integers(0, depth, more)]))
    n, near = len(place), np.abs(place[:, None] - np.arange(depth)) <= 1
    body, kept = np.nonzero(near.T)
    pattern = Pattern.of_pairs(np.full(n, q), body, kept)
    tied = np.kron(near @ near.T, np.ones((q, q), dtype=bool))
    dense = np.where(tied, rng.normal(size=(n * q,) * 2), 0.0)
    dense = dense + dense.T + 40 * (1 + more) / 7 * np.eye(n * q)
    unknowns = (pattern.first[:, None] + np.arange(q)).ravel()
    row, column = np.nonzero(tied & (unknowns[:, None] > unknowns))
    pairs = np.column_stack([unknowns[column], unknowns[row]])
    values = np.zeros(pattern.size)
    left = dense.copy()
    for together in near.T:
        at = np.flatnonzero(np.repeat(together, q))
        at = at[np.argsort(unknowns[at])]
        add(pattern, values, unknowns[at], left[np.ix_(at, at)])
        left[np.ix_(at, at)] = 0.0
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
