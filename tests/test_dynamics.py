"""Moving landmarks: detected by binning (Fig. 12), and kept out of the map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relmap import PointMapper
from relmap.core.arrays import Bools, Floats
from relmap.core.grouping.dynamics import FEWEST, Bins, binned
from tests.worlds import finished, random_rotation, walk

seeds = st.integers(0, 2**32 - 1)
dimensions = st.sampled_from([2, 3])
both_dimensions = pytest.mark.parametrize("d", [2, 3])
SIGMA = 0.05


def observed(world: Floats, rng: np.random.Generator) -> Floats:
    """Observe landmarks (n, i, d) from a robot that drives and turns, with noise."""
    d, block = world.shape[2], np.empty_like(world)
    for k in range(world.shape[1]):
        R, t = random_rotation(d, 1.0, rng), rng.uniform(-3, 3, d)
        block[:, k] = (world[:, k] - t) @ R
    return block + SIGMA * rng.standard_normal(block.shape)


def at_rest(n: int, i: int, d: int, rng: np.random.Generator) -> Floats:
    """Return n landmarks that stand still for i iterations; (n, i, d)."""
    half = 2 * n ** (1 / d)
    return np.repeat(rng.uniform(-half, half, (n, 1, d)), i, axis=1)


def departing(n: int, i: int, d: int, rng: np.random.Generator) -> Floats:
    """Return offsets of n landmarks that go their own ways at 0.2 to 0.5 m per iteration."""
    ways = rng.normal(size=(n, d))
    ways *= rng.uniform(0.2, 0.5, (n, 1)) / np.linalg.norm(ways, axis=1, keepdims=True)
    return np.asarray(ways[:, None] * np.arange(i)[:, None])


def mixed(n: int, dynamic: float, d: int, seed: int, i: int = 40) -> tuple[Floats, Bools]:
    """Return a block of landmarks and which of them are static."""
    rng = np.random.default_rng(seed)
    world, moving = at_rest(n, i, d, rng), rng.permutation(n)[: round(dynamic * n)]
    world[moving] += departing(len(moving), i, d, rng)
    static = np.ones(n, dtype=bool)
    static[moving] = False
    return observed(world, rng), static


def sorted_bins(block: Floats, priority: Floats | None = None) -> Bins:
    return binned(block, SIGMA, np.zeros(len(block)) if priority is None else priority)


def wrong(bins: Bins, static: Bools) -> int:
    """Return the number of landmarks wrongly in the static bin or missing from it."""
    return int(np.sum(np.isin(np.arange(len(static)), bins.static) != static))


# Binning (Fig. 12).


@both_dimensions
@pytest.mark.parametrize("n", [10, 25, 60, 150, 400])
@pytest.mark.parametrize("dynamic", [0.0, 0.1, 0.3, 0.5])
def test_the_largest_bin_is_the_static_landmarks(d: int, n: int, dynamic: float) -> None:
    for seed in range(6):
        block, static = mixed(n, dynamic, d, seed)
        assert wrong(sorted_bins(block), static) <= 0.02 * n


@both_dimensions
@pytest.mark.parametrize("n", [10, 25, 60, 150, 400])
@pytest.mark.parametrize("dynamic", [0.6, 0.7])
def test_a_mapped_landmark_leads_to_the_static_ones_among_many_dynamic(
    d: int, n: int, dynamic: float
) -> None:
    for seed in range(6):
        block, static = mixed(n, dynamic, d, seed)
        priority = np.zeros(n)
        priority[np.flatnonzero(static)[-1]] = 10.0
        assert wrong(sorted_bins(block, priority), static) <= 0.02 * n


@settings(max_examples=150)
@given(
    seeds,
    dimensions,
    st.integers(1, 120),
    st.floats(0.1, 0.9),
    st.floats(0, 0.6),
    st.sampled_from(["none", "random", "static", "moving"]),
)
def test_comparisons_are_never_more_than_n_log_n_as_in_figure_12(
    seed: int, d: int, n: int, dynamic: float, miss: float, mapped: str
) -> None:
    rng = np.random.default_rng(seed)
    block, static = mixed(n, dynamic, d, seed, i=12)
    block[rng.random(block.shape[:2]) < miss] = np.nan
    nobody = np.zeros(n, dtype=bool)
    at_all = {"none": nobody, "random": rng.random(n) < 0.3, "static": static, "moving": ~static}
    priority = np.where(at_all[mapped], rng.random(n), 0.0)
    often = int(np.sum(np.isfinite(block[:, :, 0]).sum(axis=1) >= FEWEST))
    assert sorted_bins(block, priority).n_comparisons <= often * np.log2(max(often, 2))


@both_dimensions
@pytest.mark.parametrize("allowed", [0, 1, 30, 100])
def test_comparisons_never_exceed_the_budget(d: int, allowed: int) -> None:
    for dynamic in (0.1, 0.5, 0.9):
        block, _ = mixed(40, dynamic, d, 0)
        assert binned(block, SIGMA, np.zeros(40), allowed).n_comparisons <= allowed


@both_dimensions
def test_the_static_landmarks_are_found_among_seventy_percent_dynamic(d: int) -> None:
    rng = np.random.default_rng(70 + d)
    found = 0
    for seed in range(1000, 1100):
        block, static = mixed(int(rng.integers(20, 150)), 0.7, d, seed)
        found += wrong(sorted_bins(block), static) <= 0.02 * len(static)
    assert found >= 95


@both_dimensions
def test_few_comparisons_are_needed_where_most_is_static(d: int) -> None:
    block, _ = mixed(400, 0.1, d, 0)
    counted = sorted_bins(block).n_comparisons
    assert 400 <= counted <= 4 * 400


@both_dimensions
def test_landmarks_that_move_together_form_a_bin(d: int) -> None:
    rng = np.random.default_rng(d)
    world = at_rest(40, 40, d, rng)
    world[18:32] += departing(1, 40, d, rng)  # a bus
    world[32:] += departing(8, 40, d, rng)
    bins = sorted_bins(observed(world, rng))
    assert [sorted(members.tolist()) for members in bins.members[:2]] == [
        list(range(18)),
        list(range(18, 32)),
    ]
    assert all(len(members) <= 2 for members in bins.members[2:])


@settings(max_examples=30)
@given(seeds, dimensions, st.integers(1, 30))
def test_no_landmark_is_in_two_bins(seed: int, d: int, n: int) -> None:
    block, _ = mixed(n, 0.5, d, seed, i=8)
    block[np.random.default_rng(seed).random(block.shape[:2]) < 0.3] = np.nan
    if not np.isfinite(block).any():
        return
    bins = sorted_bins(block)
    everybody = np.array([row for members in bins.members for row in members.tolist()])
    assert len(np.unique(everybody)) == len(everybody) <= n
    sizes = [len(members) for members in bins.members]
    assert sizes == sorted(sizes, reverse=True)


@both_dimensions
def test_gaps_do_not_matter(d: int) -> None:
    for seed in range(6):
        block, static = mixed(40, 0.4, d, seed)
        block[np.random.default_rng(seed).random(block.shape[:2]) < 0.4] = np.nan
        assert wrong(sorted_bins(block), static) <= 1


@both_dimensions
def test_landmarks_hardly_seen_together_are_not_static(d: int) -> None:
    block, _ = mixed(12, 0.0, d, 0, i=20)
    block[:6, 10 + FEWEST - 1 :] = np.nan
    block[6:, :10] = np.nan
    assert sorted_bins(block).static.tolist() in (list(range(6)), list(range(6, 12)))


@both_dimensions
def test_without_noise_a_millimetre_of_motion_is_seen(d: int) -> None:
    world = at_rest(20, 10, d, np.random.default_rng(d))
    world[7, :, 0] += 1e-3 * np.arange(10)
    assert sorted(binned(world, 0.0, np.zeros(20)).static.tolist()) == [
        k for k in range(20) if k != 7
    ]


def static_bin_with_a_circling_landmark(d: int, radius_m: float) -> list[int]:
    """Let landmark 5 go round landmark 0, which begins the first bin."""
    rng = np.random.default_rng(d)
    world = at_rest(16, 30, d, rng)
    angle = 0.02 * np.arange(30)
    world[5] = world[0]
    world[5, :, :2] += radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    priority = np.zeros(16)
    priority[0] = 1.0
    static: list[int] = sorted_bins(observed(world, rng), priority).static.tolist()
    assert len(static) >= 14
    return static


def test_what_circles_round_the_first_landmark_is_not_static_where_others_are_farther() -> None:
    assert 5 not in static_bin_with_a_circling_landmark(2, radius_m=3.0)


@both_dimensions
def test_what_circles_round_the_first_landmark_is_not_static(d: int) -> None:
    assert 5 not in static_bin_with_a_circling_landmark(d, radius_m=30.0)


# In the mapper.


def flagged(d: int, miss: float, seeds: range) -> tuple[int, int]:
    """Map static worlds; return how many landmarks are called dynamic, and how many there are."""
    dynamic = total = 0
    for seed in seeds:
        rng, mapper = np.random.default_rng(seed), PointMapper()
        for ids, points in walk(d, seed, sigma=SIGMA, iterations=150).scans:
            kept = rng.random(len(ids)) >= miss
            mapper.update(points[kept], ids[kept])
        mapper.finish()
        dynamic += int(np.sum(mapper.landmarks.status == "dynamic"))
        total += len(mapper.landmarks.status)
    return dynamic, total


@both_dimensions
def test_noise_alone_makes_nothing_dynamic(d: int) -> None:
    assert flagged(d, 0.0, range(6))[0] == 0


@both_dimensions
def test_gaps_in_sight_make_hardly_anything_dynamic(d: int) -> None:
    dynamic, total = flagged(d, 0.3, range(12))
    assert dynamic <= 0.02 * total


@both_dimensions
@pytest.mark.parametrize("known", [True, False])
def test_the_map_survives_when_noise_sets_in(d: int, known: bool) -> None:
    rng, mapper = np.random.default_rng(d), PointMapper()
    world, ids = at_rest(20, 1, d, rng)[:, 0], np.arange(20)
    for k in range(-100, 60):
        noise = SIGMA * rng.standard_normal(world.shape) if k > 0 else 0.0
        mapper.update(world - 0.05 * max(k, 0) + noise, ids if known else None)
    mapper.finish()
    assert np.mean(mapper.landmarks.status == "static") >= 0.9


@both_dimensions
def test_movers_are_dynamic_and_the_rest_is_mapped(d: int) -> None:
    lost, kept, n_static, n_moving = 0, 0, 0, 0
    for seed in range(12):
        block, static = mixed(30, 0.4, d, seed, i=60)
        mapper = finished(PointMapper(), ((block[:, k], np.arange(30)) for k in range(60)))
        found = mapper.landmarks.status
        lost, n_static = lost + int(np.sum(found[static] != "static")), n_static + int(static.sum())
        kept += int(np.sum(found[~static] != "dynamic"))
        n_moving += int((~static).sum())
    assert kept <= 0.01 * n_moving
    assert lost <= 0.04 * n_static
