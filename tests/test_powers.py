"""Refinement by the shape of the noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from relmap import MapperConfig, PointMapper, RelmapError
from relmap.core.arrays import Floats
from relmap.core.refinement.observations import Observations
from relmap.core.refinement.powers import PowerSolution, shape_of
from relmap.simulation import FigureEight, simulate_figure_eight
from tests import worlds
from tests.worlds import aligned_rmse

KEEP = MapperConfig(keep_observations=True)


def refined(world: FigureEight, config: MapperConfig, known: bool = True) -> PointMapper:
    return worlds.refined(PointMapper(config), worlds.seen(world.log, known))


def error(mapper: PointMapper, world: FigureEight) -> float:
    """Return the RMSE of the landmarks that are seen ten times: there are edges to be found."""
    found = mapper.map
    often = np.bincount(world.log.ids)[found.landmark_ids] >= 10
    return aligned_rmse(found.positions[often], world.landmarks_map[found.landmark_ids[often]])


def test_uniform_noise_is_exploited() -> None:
    ratios = []
    for seed in (40, 41):
        world = simulate_figure_eight(noise="uniform", iterations=300, seed=seed)
        mapper = refined(world, KEEP)
        assert mapper.refined[0].power == 16
        ratios.append(error(mapper, world) / error(refined(world, MapperConfig()), world))
    assert np.median(ratios) <= 0.8


def test_landmarks_seen_a_few_times_do_not_drift_away() -> None:
    world = simulate_figure_eight(noise="uniform", seed=2)
    world = replace(world, log=world.log.between(0, 100))
    counts = np.bincount(world.log.ids)
    assert counts[counts > 0].min() < 5
    assert error(refined(world, KEEP), world) < 1.2 * error(refined(world, MapperConfig()), world)


def test_normal_noise_and_outliers_leave_least_squares_as_it_is() -> None:
    rng = np.random.default_rng(3)
    world = simulate_figure_eight(iterations=300, seed=43)
    flat = simulate_figure_eight(noise="uniform", iterations=300, seed=43)
    struck = rng.random(len(flat.log.points_robot)) < 0.01
    flat.log.points_robot[struck] += rng.normal(0, 0.5, (struck.sum(), 3))
    for each in (world, flat):
        kept, without = refined(each, KEEP), refined(each, MapperConfig())
        assert kept.refined[0].power == 2
        np.testing.assert_array_equal(kept.map.positions, without.map.positions)


def test_errors_are_what_the_covariances_say() -> None:
    squares = []
    for seed in range(50, 52):
        world = simulate_figure_eight(noise="uniform", iterations=300, seed=seed)
        mapper = refined(world, KEEP)
        T = world.trajectory[mapper.refined[0].anchor_iteration]
        there = (world.landmarks_map[mapper.map.landmark_ids] - T[:3, 3]) @ T[:3, :3]
        variance = np.einsum("nii->ni", mapper.map.covariances)
        squares.append(np.mean((mapper.map.positions - there) ** 2 / variance))
    assert 0.4 < np.mean(squares) < 2.5


@pytest.mark.parametrize("d", [2, 3])
def test_the_sum_of_powers_is_least(d: int) -> None:
    rng = np.random.default_rng(d)
    landmarks = rng.uniform(-5, 5, (12, d))
    points = np.concatenate([landmarks + rng.uniform(-0.1, 0.1, (12, d)) for _ in range(60)])
    at, of = np.repeat(np.arange(60), 12), np.tile(np.arange(12), 60)
    solution = PowerSolution.of(Observations(points, of, at, np.arange(60)), landmarks)
    for power in (2, 4, 4, 4, 4, 8, 8, 8, 8, 8, 8):
        solution = solution.towards(power)

    def total(positions: Floats) -> float:
        left = solution.state.R[at].transpose(0, 2, 1) @ (
            positions.reshape(-1, d)[of] - solution.state.t[at]
        ).reshape(-1, d, 1)
        return float(np.sum((10 * (points - left[:, :, 0])) ** 8))

    best = minimize(total, solution.state.positions.ravel(), tol=1e-12)
    assert total(solution.state.positions.ravel()) <= best.fun * (1 + 1e-4)


def test_the_shape_of_known_densities() -> None:
    rng = np.random.default_rng(0)
    assert shape_of(rng.normal(size=100_000)) == pytest.approx(2, rel=0.05)
    assert shape_of(rng.laplace(size=100_000)) == pytest.approx(1, rel=0.1)
    assert shape_of(rng.uniform(-1, 1, 100_000)) > 16


def test_without_noise_and_without_ids() -> None:
    world = simulate_figure_eight(sigma=0.0, iterations=200, seed=1)
    assert error(refined(world, KEEP), world) < 1e-9
    world = simulate_figure_eight(noise="uniform", iterations=300, seed=44)
    assert refined(world, KEEP, known=False).refined[0].power == 16


def test_the_setting_is_checked() -> None:
    with pytest.raises(RelmapError, match="keep_observations is 1; it must be true or false"):
        MapperConfig.from_mapping({"keep_observations": 1})
