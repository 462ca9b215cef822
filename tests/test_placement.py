"""Placement of a scan: the trimmed fit and consistent pairs, against exhaustive search."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap.core.arrays import Bools
from relmap.core.association.placement import consistent_set, trimmed_fit
from relmap.core.geometry.alignment import fit_rigid
from tests.worlds import random_rotation

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])


@settings(max_examples=60)
@given(seeds, dimensions)
def test_trimmed_fit_finds_what_trying_every_subset_finds(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(10, 14))
    source, R, t = rng.uniform(-5, 5, (n, d)), random_rotation(d, 3.0, rng), rng.uniform(-9, 9, d)
    target = source @ R.T + t
    wrong = rng.permutation(n)[: int(rng.integers(0, n // 4 + 1))]
    astray = rng.normal(size=(len(wrong), d))
    astray /= np.linalg.norm(astray, axis=1)[:, None]
    target[wrong] += astray * rng.uniform(1, 3, (len(wrong), 1))
    counts = []
    for subset in itertools.combinations(range(n), d):
        rows = list(subset)
        fitted_R, fitted_t = fit_rigid(source[rows], target[rows])
        apart = np.linalg.norm(source @ fitted_R.T + fitted_t - target, axis=1)
        counts.append(int(np.sum(apart <= 0.1)))
    placement = trimmed_fit(source, target, 0.1)
    assert placement.n_agreeing == max(counts) == n - len(wrong)
    np.testing.assert_allclose(placement.apply(source), source @ R.T + t, atol=1e-9)


def test_trimmed_fit_of_too_few_is_none() -> None:
    assert trimmed_fit(np.zeros((1, 2)), np.zeros((1, 2)), 0.1) is None
    assert trimmed_fit(np.zeros((2, 3)), np.zeros((2, 3)), 0.1) is None


def largest_clique(agree: Bools) -> int:
    """Return the size of the largest set of which all agree, by trying them all."""

    def grown(size: int, candidates: list[int]) -> int:
        rest = [
            grown(size + 1, [b for b in candidates[i + 1 :] if agree[a, b]])
            for i, a in enumerate(candidates)
        ]
        return max([size, *rest])

    return grown(0, list(range(len(agree))))


@settings(max_examples=60)
@given(seeds, dimensions, st.sampled_from([0.1, 1.0]))
def test_the_consistent_set_is_the_largest_set_that_agrees(
    seed: int, d: int, tolerance_m: float
) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 8))
    source = rng.uniform(-5, 5, (n, d))
    target = source @ random_rotation(d, 3.0, rng).T + rng.uniform(-9, 9, d)
    candidates = np.vstack([np.column_stack([np.arange(n)] * 2), rng.integers(0, n, (7, 2))])
    pairs = rng.permutation(np.unique(candidates, axis=0))
    chosen = consistent_set(source, target, pairs, tolerance_m)
    a, b = pairs.T
    here = np.linalg.norm(source[a][:, None] - source[a], axis=2)
    there = np.linalg.norm(target[b][:, None] - target[b], axis=2)
    agree = (np.abs(here - there) <= tolerance_m) & (a[:, None] != a) & (b[:, None] != b)
    assert agree[np.ix_(chosen, chosen)][~np.eye(len(chosen), dtype=bool)].all()
    assert len(chosen) == largest_clique(agree)
