"""Where the noise makes single matches ambiguous, each observation is assigned anew."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.alignment import fit_rigid
from relmap.core.refinement.assignment.mixture import Mixture
from relmap.core.refinement.assignment.mixture_kernels import fit_few, weigh
from relmap.core.refinement.assignment.reassigning import reassign, reassigned
from relmap.core.refinement.joint import Refined
from relmap.simulation import WorldSpec, simulate_world
from tests.worlds import mapped_world, stands_for

LIMIT, COST = 12.25, 3.0


def drawn(seed: int, dimension: int) -> tuple[Floats, Ints, Floats, Floats]:
    """Return observations of five landmarks in twelve scans, which miss some and show others.

    Observations (n, d), where each scan begins, and ends, the log odds of the scans, and positions
    near the landmarks; in standard deviations.
    """
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-3, 3, (5, dimension))
    seen = rng.uniform(size=(12, 5)) < 0.8
    scans = [landmarks[row] + rng.normal(size=(row.sum(), dimension)) for row in seen]
    scans[3] = np.vstack([scans[3], rng.uniform(-5, 5, (2, dimension))])
    begin = np.cumsum([0, *map(len, scans)])
    odds = rng.uniform(-1, 2, len(scans))
    return np.concatenate(scans), begin, odds, landmarks + rng.normal(size=landmarks.shape)


def best_assignment(gain: Floats) -> float:
    positive = np.maximum(gain, 0)
    return float(positive[linear_sum_assignment(positive, maximize=True)].sum())


def likelihood_at(placed: Floats, metric: Floats, begin: Ints, odds: Floats, at: Floats) -> float:
    """Return the likelihood of the best assignment, scan by scan."""
    square = np.sum(((placed[:, None] - at) @ np.swapaxes(metric, 1, 2)) ** 2, axis=2)
    gains = (LIMIT - square) / 2 + np.repeat(odds, np.diff(begin))[:, None]
    scans = np.split(gains, begin[1:-1])
    return sum(map(best_assignment, scans)) - COST * len(at)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_a_fit_is_a_best_assignment_and_its_means(seed: int, dimension: int) -> None:
    placed, begin, odds, start = drawn(seed, dimension)
    n = len(placed)
    shape = (n, dimension, dimension)
    metric = np.eye(dimension) + 0.3 * np.random.default_rng(seed).normal(size=shape)
    means, found = start.copy(), np.full(n, -1)
    likelihood = fit_few(placed, metric, begin, odds, COST, means, found)
    assert likelihood >= likelihood_at(placed, metric, begin, odds, start)
    expected = likelihood_at(placed, metric, begin, odds, means)
    assert likelihood == pytest.approx(expected, rel=1e-12)
    for k in np.unique(found[found >= 0]):
        own = found == k
        left, right = metric[own].reshape(-1, dimension), (metric[own] @ placed[own][:, :, None])
        mean = np.linalg.lstsq(left, right.ravel(), rcond=None)[0]
        np.testing.assert_allclose(means[k], mean, atol=1e-10)
    for scan in np.split(found, begin[1:-1]):
        named = scan[scan >= 0]
        assert len(named) == len(np.unique(named))


@pytest.mark.parametrize("seed", range(3))
def test_assignments_are_weighed_as_by_listing_them(seed: int) -> None:
    odds = np.exp(np.random.default_rng(seed).normal(size=(5, 3)))
    begin = np.array([0, 3, 3, 5])
    share = weigh(odds, begin)
    for scan in (slice(0, 3), slice(3, 5)):
        here, total = odds[scan], 0.0
        expected = np.zeros_like(here)
        for choice in itertools.product(range(-1, 3), repeat=len(here)):
            named = [j for j in choice if j >= 0]
            if len(named) == len(set(named)):
                pairs = [(i, j) for i, j in enumerate(choice) if j >= 0]
                each = np.prod([here[pair] for pair in pairs])
                total += each
                for pair in pairs:
                    expected[pair] += each
        np.testing.assert_allclose(share[scan], expected / total, rtol=1e-12)


def test_landmarks_closer_than_the_noise_are_not_biased_apart() -> None:
    """Two among others, 1.2 standard deviations apart: means of best assignments are 1.8 apart."""
    rng = np.random.default_rng(3)
    truth = np.array([[0.0, 0], [1.2, 0], [9, 1], [1, 9], [-8, 2], [3, -9], [9, 9]])
    seen = rng.uniform(size=(400, 7)) < 0.9
    points = np.concatenate([truth[row] + rng.normal(size=(row.sum(), 2)) for row in seen])
    scan, own = np.nonzero(seen)
    equal = np.broadcast_to(np.eye(2), (len(points), 2, 2))
    mixture = Mixture(points, equal, scan, own, truth.copy(), np.ones(7, dtype=np.bool_))
    mixture.fit()
    settled, square = mixture.settled()
    apart, biased = (np.linalg.norm(at[1] - at[0]) for at in (settled, mixture.positions))
    assert biased > 1.6
    assert apart == pytest.approx(1.2, abs=0.15)
    assert square == pytest.approx(1.0, abs=0.05)


def test_a_landmark_that_the_map_lacks_is_found() -> None:
    """One of two, 2.5 standard deviations apart, is not mapped, and the other is between them."""
    rng = np.random.default_rng(3)
    truth = np.array([[0.0, 0], [9, 1], [1, 9], [-8, 2], [3, -9], [9, 9], [2.5, 0]])
    seen = rng.uniform(size=(40, 7)) < 0.9
    points = np.concatenate([truth[row] + rng.normal(size=(row.sum(), 2)) for row in seen])
    scan, own = np.nonzero(seen)
    equal = np.broadcast_to(np.eye(2), (len(points), 2, 2))
    positions = truth[:6].copy()
    positions[0, 0], own[own == 6] = 1.25, -1
    mixture = Mixture(points, equal, scan, own, positions, np.ones(6, dtype=np.bool_))
    mixture.fit()
    settled = mixture.settled()[0]
    assert len(settled) == 7
    assert mixture.exists.all()
    pair = settled[[0, 6]]
    np.testing.assert_allclose(pair[np.argsort(pair[:, 0])], truth[[0, 6]], atol=0.6)


@pytest.mark.parametrize("seed", [5, 8])
def test_ambiguous_matches_do_not_spoil_a_map(seed: int) -> None:
    """With a fifth of the spacing as noise, landmarks were doubled, and others between two."""
    spec = WorldSpec(kind="field", length_m=150.0, iterations=110, sigma=0.4, seed=seed)
    mapper, rmse_m = mapped_world(spec)
    ids = simulate_world(spec).true_ids
    assert len(mapper.map) == np.count_nonzero(np.bincount(ids[ids >= 0]) >= 3)
    assert rmse_m < 0.13


def test_mixed_tracks_do_not_hide_a_loop() -> None:
    """Forty landmarks were mapped twice, a metre apart, as their tracks were mixed."""
    spec = WorldSpec(kind="field", length_m=150.0, iterations=110, sigma=0.4, seed=9)
    mapper, rmse_m = mapped_world(spec)
    assert 100 <= len(mapper.map) <= len(simulate_world(spec).landmark_ids)
    assert rmse_m < 0.2


def test_observations_are_assigned_anew_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the last refinement uses their assignments; two before it assigned them in vain."""
    calls = []

    def counted(*given: Any) -> Refined:
        calls.append(given)
        return reassign(*given)

    monkeypatch.setattr("relmap.core.refining.reassign", counted)
    mapped_world(WorldSpec(kind="field", length_m=60.0, iterations=40, sigma=0.4, seed=5))
    assert len(calls) == 1


def test_tracks_follow_their_observations() -> None:
    """No two landmarks of the map are most often the same one."""
    world = simulate_world(
        WorldSpec(kind="field", length_m=150.0, iterations=110, sigma=0.4, seed=5)
    )
    mapper = PointMapper()
    labels = np.concatenate([mapper.update(scan.points_robot) for scan in world.log.scans()])
    mapper.finish()
    mapper.refine()
    names = stands_for(mapper.landmarks_of(labels), world.true_ids)
    ids = np.array([names[label] for label in mapper.map.landmark_ids.tolist()])
    assert len(np.unique(ids)) == len(ids)
    at = np.searchsorted(world.landmark_ids, ids)
    R, t = fit_rigid(mapper.map.positions, world.landmarks_map[at])
    off_m = np.linalg.norm(mapper.map.positions @ R.T + t - world.landmarks_map[at], axis=1)
    assert off_m.max() < 0.6


def test_without_ambiguity_observations_are_not_kept() -> None:
    world = simulate_world(WorldSpec(length_m=150.0, iterations=110, seed=5))
    mapper = PointMapper()
    for scan in world.log.scans():
        mapper.update(scan.points_robot)
    assert not len(mapper.engine.kept)


def test_scans_that_determine_nothing_leave_a_submap_as_it_is() -> None:
    """Each scan shows one landmark, which does not determine its pose."""
    mapper, _ = mapped_world(WorldSpec(kind="field", length_m=60.0, iterations=40, seed=5))
    (refined,) = mapper.refined
    seen, when = refined.landmarks, np.arange(len(refined.landmarks))
    single = np.ones((len(seen), 2)), seen, when, None
    assert reassign(refined, *single) is refined
    np.testing.assert_array_equal(reassigned(refined, *single), seen)


@pytest.mark.parametrize("seed", [4, 6])
def test_unequal_noise_is_that_of_each_observation(seed: int) -> None:
    """Bearings are ten times worse than ranges: maps were 0.165 and 0.069 m off."""
    _, rmse_m = mapped_world(WorldSpec(noise="bearing", length_m=200.0, iterations=140, seed=seed))
    assert rmse_m < 0.03
