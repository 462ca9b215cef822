"""Noise that differs by direction and distance: its estimate, its metric, and maps made with it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares, nnls
from scipy.spatial.transform import Rotation

from relmap import PointMapper, range_bearing_covariances
from relmap.comparison.baselines.batch import Batch, batch_least_squares
from relmap.core.arrays import Floats, Ints
from relmap.core.association import matching_kernels
from relmap.core.association.metric import LONGEST, OUTLIER, WAIT, RayNoise, farthest, nonnegative
from relmap.core.association.placement import trimmed_fit
from relmap.core.association.reobservation.coinciding import compatible
from relmap.evaluation.metrics import majority_ids
from relmap.simulation import World, WorldSpec, simulate_figure_eight, simulate_world
from relmap.simulation.worlds import covariances_of
from tests.kernels import callable_here
from tests.worlds import random_rotation

buckets = callable_here(matching_kernels.buckets)
nearest_to = callable_here(matching_kernels.nearest_to)
Array = Floats
SIGMA = 0.05


def turned(rng: np.random.Generator, n: int) -> Array:
    """Return random directions (n, 2)."""
    angle = rng.uniform(-np.pi, np.pi, n)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def rays_of(noise: str, d: int, rng: np.random.Generator) -> RayNoise:
    """Return an estimate from static landmarks, predicted from eight observations each."""
    rays = RayNoise()
    for _ in range(60):
        points = rng.uniform(-14, 14, (20, d))
        roots = np.linalg.cholesky(covariances_of(points, SIGMA, noise))
        seen = points + (roots @ rng.normal(size=(20, d, 1)))[:, :, 0]
        mean = points + (roots @ rng.normal(size=(20, d, 1)))[:, :, 0] / np.sqrt(8)
        if rays.is_due():
            rays.learn(mean, seen, np.full(20, 8))
    return rays


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("noise", ["range", "bearing", "stereo"])
def test_the_estimate_is_the_noise_of_the_sensor(noise: str, d: int) -> None:
    rng = np.random.default_rng(3)
    rays = rays_of(noise, d, rng)
    points = rng.normal(size=(50, d))
    points *= (rng.uniform(6, 14, 50) / np.linalg.norm(points, axis=1))[:, None]
    true = covariances_of(points, SIGMA, noise)
    ratio = np.linalg.eigvals(np.linalg.solve(true, rays.covariances(points)))
    assert np.sqrt(ratio.real).min() > 0.6
    assert np.sqrt(ratio.real).max() < 1.6
    metric = rays.metric(points)
    even = np.linalg.eigvalsh(metric @ true @ metric)
    assert np.sqrt(even.max() / even.min()) < 2.2
    np.testing.assert_allclose(np.linalg.slogdet(metric)[1].mean(), 0, atol=1e-9)


@pytest.mark.parametrize("of", ["any", "one distance", "two distances", "origin", "exact"])
def test_the_variance_is_fitted_as_by_scipy(of: str) -> None:
    """At one or two distances or at the origin, terms are proportional to each other or 0."""
    rng = np.random.default_rng(0)
    for n in rng.integers(1, 200, 40).tolist():
        given = {"one distance": [5.0], "two distances": [2.0, 6.0], "origin": [0.0]}
        distance = rng.choice(given[of], n) if of in given else rng.uniform(0, 14, n)
        variance = rng.uniform(0.1, 2, n)
        square = 0 * variance if of == "exact" else 3 * variance * rng.normal(size=n) ** 2
        unit_m = max(distance.max(), 1.0)
        terms = np.vander((distance / unit_m) ** 2, 3, increasing=True) / variance[:, None]
        clipped = np.minimum(square / variance, OUTLIER)
        found = nonnegative(terms[None], clipped[None])[0]
        assert (found >= 0).all()
        residual = np.linalg.norm(terms @ found - clipped)
        np.testing.assert_allclose(residual, nnls(terms, clipped)[1], rtol=1e-9, atol=1e-9)


def test_isotropic_noise_has_no_metric() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rays = rays_of("isotropic", 2, rng)
        assert rays.is_unequal is False
        assert rays.metric(rng.normal(size=(9, 2))) is None


def test_noise_free_matches_give_no_metric() -> None:
    rays, rng = RayNoise(), np.random.default_rng(1)
    with np.errstate(all="raise"):
        for reach_m in [0.1] + 40 * [100.0]:
            points = rng.uniform(-reach_m, reach_m, (8, 2))
            if rays.is_due():
                rays.learn(points, points.copy(), np.full(8, 3))
    assert rays.is_unequal is False
    assert rays.metric(points) is None


def test_observations_wait_for_the_estimate_no_longer_than_memory_allows() -> None:
    rays, unequal = RayNoise(), rays_of("bearing", 2, np.random.default_rng(3))
    for n, weighs, weighs_unequal in ((WAIT - 1, None, None), (WAIT, None, True)):
        rays.decide(n, np.nan)
        unequal.decide(n, np.nan)
        assert (rays.weighs, unequal.weighs) == (weighs, weighs_unequal)
    rays.decide(LONGEST, np.nan)
    assert rays.weighs is False


def test_motion_does_not_pass_for_unequal_noise() -> None:
    """Half of the landmarks move: their residuals differ by direction and distance."""
    mapper = PointMapper()
    for scan in simulate_figure_eight(iterations=90, dynamic=0.5, seed=1).log.scans():
        mapper.update(scan.points_robot)
        rays = mapper.engine.association.current.estimated
        if rays is not None and rays.weighs is not None:
            break
    assert rays is not None
    assert (rays.is_unequal, rays.weighs) == (True, False)


def test_no_observation_is_kept_once_the_noise_is_known_to_be_isotropic() -> None:
    log, mapper, kept = simulate_world(WorldSpec(seed=3)).log, PointMapper(), []
    for scan in log.scans():
        mapper.update(scan.points_robot)
        kept.append(len(mapper.engine.kept))
    assert WAIT / 2 < max(kept) < 2 * WAIT
    assert kept[-1] == 0


def random_metric(n: int, d: int, rng: np.random.Generator) -> Array:
    roots = rng.normal(size=(n, d, d))
    return np.asarray(roots @ np.swapaxes(roots, 1, 2) + 0.3 * np.eye(d))


@pytest.mark.parametrize("d", [2, 3])
def test_nearest_by_a_metric_is_what_trying_all_finds(d: int) -> None:
    rng = np.random.default_rng(d)
    points, queries = rng.uniform(-4, 4, (40, d)), rng.uniform(-4, 4, (60, d))
    metric, reach = random_metric(40, d, rng), 1.5
    grid, apart = buckets(points, reach, farthest(reach, metric)), np.empty(d)
    found = [nearest_to(query, points, grid, metric, apart) for query in queries]
    square, index = np.array(found).T
    off = np.einsum("nij,knj->kni", metric, queries[:, None] - points)
    every = np.linalg.norm(off, axis=2)
    within = every.min(axis=1) < reach
    assert 0 < within.sum() < 60
    np.testing.assert_array_equal(index, np.where(within, every.argmin(axis=1), 40))
    np.testing.assert_allclose(square[within], every.min(axis=1)[within] ** 2)


@pytest.mark.parametrize("d", [2, 3])
def test_weighted_fit_is_that_of_scipy_without_the_outliers(d: int) -> None:
    rng = np.random.default_rng(d)
    source, R, t = rng.uniform(-9, 9, (25, d)), random_rotation(d, 1.0, rng), rng.uniform(-2, 2, d)
    metric = random_metric(25, d, rng)
    noise = np.linalg.solve(metric, 0.05 * rng.normal(size=(25, d, 1)))[:, :, 0]
    target = source @ R.T + t + noise
    target[:4] += 6.0
    found = trimmed_fit(source, target, 0.3, metric)
    assert found.n_agreeing == 21

    def residuals(x: Array) -> Array:
        if d == 2:
            turn = Rotation.from_euler("z", x[0]).as_matrix()[:2, :2]
        else:
            turn = Rotation.from_rotvec(x[:3]).as_matrix()
        off = target[4:] - source[4:] @ turn.T - x[-d:]
        return np.asarray(np.einsum("nij,nj->ni", metric[4:], off).ravel())

    solved = least_squares(residuals, np.zeros(3 * d - 3), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    off = target[4:] - found.apply(source[4:])
    own = np.sum(np.einsum("nij,nj->ni", metric[4:], off) ** 2)
    assert own <= 2 * solved.cost * (1 + 1e-6)


@cache
def stereo(seed: int, iterations: int) -> World:
    spec = WorldSpec(noise="stereo", sigma=0.03, space=True, seed=seed)
    return simulate_world(replace(spec, iterations=iterations, length_m=1.5 * iterations))


@cache
def by_least_squares(world: World) -> tuple[Ints, Array]:
    """Return the landmarks of a world that were seen, and their positions by unweighted fit."""
    seen, of = np.unique(world.true_ids, return_inverse=True)
    batch = Batch(world.log.points_robot, world.log.iteration, of)
    start = world.landmarks_map[seen, : world.log.points_robot.shape[1]]
    return seen, batch_least_squares(batch, start, iterations=1000)


def mapped(world: World, with_covariances: bool) -> tuple[PointMapper, Ints]:
    """Map a world by own association; return the true landmarks that those of the map are."""
    mapper, end, labels = PointMapper(), 0, []
    for scan in world.log.scans():
        rows = slice(end, end + len(scan.points_robot))
        noise = world.covariances[rows] if with_covariances else None
        labels.append(mapper.update(scan.points_robot, covariances=noise))
        end = rows.stop
    mapper.finish()
    mapper.refine()
    now = mapper.landmarks_of(np.concatenate(labels))
    true_of = dict(zip(*majority_ids(now, world.true_ids)[:2], strict=True))
    return mapper, np.array([true_of[label] for label in mapper.map.landmark_ids.tolist()])


def rmse(positions: Array, truth: Array) -> float:
    from relmap.core.geometry.alignment import fit_rigid

    R, t = fit_rigid(positions, truth)
    return float(np.sqrt(np.mean(np.sum((positions @ R.T + t - truth) ** 2, axis=1))))


@pytest.mark.parametrize("with_covariances", [True, False])
def test_a_stereo_camera_gives_one_map_better_than_unweighted_least_squares(
    with_covariances: bool,
) -> None:
    world = stereo(11, 140)
    mapper, ids = mapped(world, with_covariances)
    seen, limit = by_least_squares(world)
    there = world.landmarks_map[ids]
    assert len(mapper.submaps) == 1
    assert rmse(mapper.map.positions, there) < 0.3 * rmse(limit[np.searchsorted(seen, ids)], there)


def test_landmarks_that_coincide_by_given_covariances_are_merged() -> None:
    """Before, one was mapped twice, and the map was 0.11 m off."""
    world = stereo(3, 240)
    mapper, ids = mapped(world, with_covariances=True)
    assert len(np.unique(ids)) == len(ids)
    assert rmse(mapper.map.positions, world.landmarks_map[ids]) < 0.04


def test_errors_that_last_are_not_averaged_out() -> None:
    """Ranges off by the same for twelve scans: errors were 2.9 times the standard deviations."""
    rng, sd_m, off_m = np.random.default_rng(4), [], []
    true = rng.uniform(-12, 12, (40, 2))
    for lasting in (1, 12):
        noise = np.repeat(rng.normal(0, 0.2, (144 // lasting, len(true))), lasting, axis=0)
        mapper = PointMapper()
        for k, error in enumerate(noise):
            seen = true - [0.05 * k, 0]
            r, bearing = np.hypot(*seen.T), np.arctan2(seen[:, 1], seen[:, 0])
            bearing += rng.normal(0, 0.002, len(true))
            points = (r + error)[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
            mapper.update(
                points, np.arange(len(true)), range_bearing_covariances(points, 0.2, 0.002)
            )
        mapper.finish()
        mapper.refine()
        found = mapper.map
        sd_m.append(float(np.sqrt(np.trace(found.covariances, axis1=1, axis2=2).mean())))
        off_m.append(rmse(found.positions[:, :2], true[found.landmark_ids]))
    assert sd_m[1] > 1.8 * sd_m[0]
    assert off_m[1] > 2 * off_m[0]


def test_landmarks_coincide_within_their_covariances_and_with_no_other() -> None:
    """Pairs 2 m apart: along the error, across it, along it with a third near, and undetermined."""
    along, across = [10.0, 0.0], [0.0, 10.0]
    positions = np.array(
        [[0.0, 0], [2, 0], along, [10, 2], across, [2, 10], [1, 10], [20, 20], [20, 20], [30, 5]]
    )
    covariances = np.tile(np.diag([1.0, 0.01]), (10, 1, 1))
    covariances[7] = np.nan
    assert compatible(positions, covariances).tolist() == [[0, 1]]


def test_an_observation_of_unknown_place_does_not_take_the_matches_of_others() -> None:
    world = simulate_world(WorldSpec(iterations=60, length_m=90.0, seed=12))
    plain, mapper = PointMapper(), PointMapper()
    for scan in world.log.scans():
        covariances = np.tile(np.eye(2) * SIGMA**2, (len(scan.points_robot), 1, 1))
        covariances[:1, 0, 0] *= 1e6
        plain.update(scan.points_robot)
        mapper.update(scan.points_robot, covariances=covariances)
    for each in (plain, mapper):
        each.finish()
        each.refine()
    assert len(mapper.submaps) == len(plain.submaps) == 1
    assert len(mapper.map.landmark_ids) >= 0.9 * len(plain.map.landmark_ids)


def test_far_landmarks_do_not_contradict_the_map_where_noise_grows_with_the_range() -> None:
    """At 0.5 to 500 m, with noise of 1 %, a warning said that 8 % of the ids might be wrong."""
    rng = np.random.default_rng(0)
    places = np.exp(rng.uniform(np.log(0.5), np.log(500.0), 60))[:, None] * turned(rng, 60)
    places[:, 0] += rng.uniform(0, 60, 60)
    mapper = PointMapper()
    for k in range(200):
        away = places - [0.3 * k, 0.0]
        noise = 0.01 * np.linalg.norm(away, axis=1)[:, None] * rng.normal(size=away.shape)
        mapper.update(away + noise, ids=np.arange(60))
    mapper.finish()
    mapper.refine()
    assert len(mapper.map.landmark_ids) == 60
    assert sum(one.n_outliers for one in mapper.refined) <= 0.005 * 60 * 200


def test_a_run_that_estimates_its_noise_goes_on_after_loading(tmp_path: Path) -> None:
    spec = WorldSpec(noise="bearing", iterations=120, length_m=180.0, seed=12)
    plain, saved = PointMapper(), PointMapper()
    for k, scan in enumerate(simulate_world(spec).log.between(0, 75).scans()):
        if k in (5, 30, 31, 65):  # the estimate is used from iteration 58 on
            saved.save(tmp_path / "mapper.npz")
            saved = PointMapper.load(tmp_path / "mapper.npz")
        labels = plain.update(scan.points_robot)
        np.testing.assert_array_equal(saved.update(scan.points_robot), labels)
    for mapper in (plain, saved):
        mapper.finish()
        mapper.refine()
    assert plain.engine.association.current.estimates_covariances
    assert plain.map.positions.tobytes() == saved.map.positions.tobytes()
