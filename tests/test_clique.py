"""The largest set of matches that agree, against trying all of them and against greedy growth."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relmap.core.arrays import Floats, Ints
from relmap.core.association.clique_kernels import agreeing, largest_clique
from relmap.core.association.placement import consistent_set, trimmed_fit
from tests.worlds import random_rotation

N, SIGMA = 30, 0.05


@given(st.integers(0, 2**32 - 1), st.integers(1, 11), st.floats(0.1, 0.95))
def test_no_clique_is_larger(seed: int, n: int, density: float) -> None:
    edges = np.triu(np.random.default_rng(seed).random((n, n)) < density, 1)
    agree = edges | edges.T
    found = largest_clique(agree, 10**9).tolist()
    assert all(agree[i, j] for i, j in combinations(found, 2))
    larger = combinations(range(n), len(found) + 1)
    assert not any(all(agree[i, j] for i, j in combinations(nodes, 2)) for nodes in larger)


def test_if_steps_run_out_the_result_is_still_a_clique() -> None:
    edges = np.triu(np.random.default_rng(0).random((150, 150)) < 0.6, 1)
    agree = edges | edges.T
    few, many = (largest_clique(agree, steps) for steps in (0, 300))
    for found in (few, many):
        assert all(agree[i, j] for i, j in combinations(found.tolist(), 2))
    assert 0 < len(few) <= len(many)


def all_to_all(seed: int, overlap: float, d: int) -> tuple[Floats, Floats, Ints]:
    """Return two views of a world that share some points, those with the same row, turned."""
    rng = np.random.default_rng(seed)
    here = rng.uniform(0, 10, (N, d))
    shared = int(N * overlap)
    there = np.vstack([here[:shared], rng.uniform(0, 10, (N - shared, d))])
    there = there @ random_rotation(d, 3.0, rng).T + SIGMA * rng.standard_normal((N, d))
    pairs = np.indices((N, N), dtype=np.int64).reshape(2, -1).T
    return here, there, pairs


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("overlap", [0.5, 0.3])
def test_views_that_share_little_are_matched_without_any_gate(overlap: float, d: int) -> None:
    for seed in range(20):
        here, there, pairs = all_to_all(seed, overlap, d)
        chosen = pairs[consistent_set(here, there, pairs, 4 * SIGMA)]
        placement = trimmed_fit(here[chosen[:, 0]], there[chosen[:, 1]], 4 * SIGMA)
        shared = int(N * overlap)
        off = np.linalg.norm(placement.apply(here[:shared]) - there[:shared], axis=1)
        assert np.median(off) < 3 * SIGMA


def test_matches_agree_where_both_points_are_others_and_as_far_apart() -> None:
    here = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    there = here + 1.0
    a, b = np.array([0, 1, 1, 3]), np.array([0, 1, 2, 3])
    agree = agreeing(here, there, a, b, 1e-9)
    assert agree.tolist() == [
        [False, True, True, True],
        [True, False, False, True],
        [True, False, False, True],
        [True, True, True, False],
    ]
    assert not agreeing(here, 1.1 * there, a, b, 0.2)[0, 1]
