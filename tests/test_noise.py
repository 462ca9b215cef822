from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap.core.arrays import Floats
from relmap.core.grouping.noise import FORGETTING, NoiseEstimate, guess_noise
from tests.worlds import random_rotation

both_dimensions = pytest.mark.parametrize("d", [2, 3])
SIGMA = 0.05


def seen_block(
    g: int, i: int, d: int, rng: np.random.Generator, movers: int = 0, uniform: bool = False
) -> Floats:
    """Observe g landmarks, some of them moving, in i iterations from random poses."""
    half = 2 * g ** (1 / d)
    world = np.repeat(rng.uniform(-half, half, (g, 1, d)), i, axis=1)
    ways = rng.normal(size=(movers, d))
    ways *= rng.uniform(0.1, 0.4, (movers, 1)) / np.linalg.norm(ways, axis=1, keepdims=True)
    world[rng.permutation(g)[:movers]] += ways[:, None] * np.arange(i)[:, None]
    block = np.empty_like(world)
    for k in range(i):
        block[:, k] = (world[:, k] - rng.uniform(-20, 20, d)) @ random_rotation(d, 3.0, rng)
    if uniform:
        return block + rng.uniform(-np.sqrt(3), np.sqrt(3), block.shape) * SIGMA
    return block + SIGMA * rng.standard_normal(block.shape)


def estimated(blocks: list[Floats]) -> float:
    noise = NoiseEstimate()
    for block in blocks:
        noise.add(block)
    return noise.sigma_m


def test_of_a_large_group_every_so_many_members_are_used() -> None:
    block = seen_block(640, 10, 3, np.random.default_rng(0))
    assert estimated([block]) == estimated([block[::10]]) == pytest.approx(SIGMA, rel=0.05)


@both_dimensions
@pytest.mark.parametrize(("g", "i"), [(4, 10), (4, 40), (10, 4), (10, 10), (40, 10)])
def test_estimate_is_unbiased(d: int, g: int, i: int) -> None:
    rng = np.random.default_rng(g)
    blocks = [seen_block(g, i, d, rng) for _ in range(150)]
    assert estimated(blocks) == pytest.approx(SIGMA, rel=0.05)


@both_dimensions
def test_estimate_holds_for_uniform_noise(d: int) -> None:
    rng = np.random.default_rng(d)
    blocks = [seen_block(12, 12, d, rng, uniform=True) for _ in range(100)]
    assert estimated(blocks) == pytest.approx(SIGMA, rel=0.05)


@both_dimensions
def test_estimate_of_perfect_observations_is_zero(d: int) -> None:
    rng = np.random.default_rng(d)
    block = seen_block(8, 10, d, rng)
    still = np.repeat(block[:, :1], 10, axis=1)
    assert estimated([still]) < 1e-12


def test_estimate_is_unknown_before_anything_was_seen_twice() -> None:
    assert np.isnan(NoiseEstimate().sigma_m)
    assert np.isnan(estimated([np.zeros((5, 1, 3)), np.zeros((1, 9, 3))]))


def test_the_estimate_is_not_below_what_observations_say_of_their_noise() -> None:
    noise, still = NoiseEstimate(), np.ones((4, 10, 2)) * np.arange(4)[:, None, None]
    for least_m in (0.02, 0.0, 0.02):
        noise.limit(least_m)
    assert np.isnan(noise.sigma_m)
    noise.add(still)
    assert noise.sigma_m == pytest.approx(0.02)
    noise.limit(0.12)
    assert noise.sigma_m == pytest.approx(0.02 + 0.1 * (1 - FORGETTING))


def test_what_was_seen_long_ago_is_forgotten() -> None:
    rng = np.random.default_rng(0)
    blocks = [seen_block(10, 10, 2, rng) for _ in range(600)]
    twice = [2 * block for block in blocks]
    n = 100
    old = FORGETTING**n
    expected = SIGMA * np.sqrt(old * 1 + (1 - old) * 4)  # variances are averaged by weight
    assert estimated(blocks + twice[:n]) == pytest.approx(expected, rel=0.03)
    assert estimated(blocks + twice) == pytest.approx(2 * SIGMA, rel=0.03)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.floats(1e-3, 1e3))
def test_estimates_scale_with_the_unit(seed: int, d: int, scale: float) -> None:
    block = seen_block(8, 8, d, np.random.default_rng(seed))
    assert estimated([scale * block]) == pytest.approx(scale * estimated([block]))
    assert guess_noise(scale * block) == pytest.approx(scale * guess_noise(block))


@both_dimensions
@pytest.mark.parametrize(
    ("g", "i", "movers"),
    [(6, 10, 0), (6, 20, 2), (12, 10, 0), (12, 10, 5), (40, 10, 0), (40, 10, 26), (80, 20, 40)],
)
def test_guess_is_within_a_factor_two(d: int, g: int, i: int, movers: int) -> None:
    rng = np.random.default_rng(g + movers)
    for _ in range(15):
        block = seen_block(g, i, d, rng, movers=movers)
        assert SIGMA / 2 < guess_noise(block) < 2 * SIGMA


@both_dimensions
@pytest.mark.parametrize(("g", "i"), [(20, 20), (20, 40), (40, 20)])
def test_motion_is_not_guessed_to_be_noise(d: int, g: int, i: int) -> None:
    """Three of four move: few pairs keep their distance, but noise is not gradual."""
    rng = np.random.default_rng(g + i)
    for _ in range(15):
        assert guess_noise(seen_block(g, i, d, rng, movers=3 * g // 4)) < 2 * SIGMA


@both_dimensions
def test_guess_copes_with_gaps(d: int) -> None:
    rng = np.random.default_rng(d)
    for _ in range(15):
        block = seen_block(20, 20, d, rng, movers=6)
        block[rng.random(block.shape[:2]) < 0.4] = np.nan
        assert SIGMA / 2 < guess_noise(block) < 2 * SIGMA


def test_no_estimate_without_repeated_observations() -> None:
    assert np.isnan(guess_noise(np.zeros((1, 5, 2))))
    assert np.isnan(guess_noise(np.zeros((4, 1, 2))))
    apart = np.full((2, 4, 2), np.nan)
    apart[0, :2] = apart[1, 2:] = 1.0
    assert np.isnan(guess_noise(apart))
