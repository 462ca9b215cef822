from __future__ import annotations

import numpy as np
import pytest

from relmap import RelmapError
from relmap.simulation import figure_eight as eight
from relmap.simulation import simulate_figure_eight
from relmap.simulation.figure_eight import REACH_M, dynamic_offsets


def errors(world: eight.FigureEight) -> np.ndarray:
    """Return the observation errors (n, 3) of the static landmarks."""
    log = world.log
    T = world.trajectory[log.iteration]
    true = np.einsum("nij,ni->nj", T[:, :3, :3], world.landmarks_map[log.ids] - T[:, :3, 3])
    return np.asarray((log.points_robot - true)[world.status[log.ids] == "static"])


def test_the_loop_is_as_long_as_it_says_and_climbs_half_way() -> None:
    path = simulate_figure_eight(iterations=eight.LOOP_ITERATIONS + 1).trajectory[:, :3, 3]
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.sum() == pytest.approx(eight.LOOP_LENGTH_M, rel=1e-3)
    np.testing.assert_allclose(steps, eight.LOOP_LENGTH_M / eight.LOOP_ITERATIONS, rtol=1e-3)
    np.testing.assert_allclose(path[0], path[-1], atol=1e-6)
    half = path[eight.LOOP_ITERATIONS // 2]
    np.testing.assert_allclose(half, [0, 0, eight.HEIGHT_M], atol=0.05)
    assert (np.diff(path[: eight.LOOP_ITERATIONS // 2, 2]) > 0).all()
    assert (np.diff(path[eight.LOOP_ITERATIONS // 2 :, 2]) < 0).all()


@pytest.mark.parametrize("density", [25.0, 100.0, 1000.0])
def test_density_is_landmarks_per_hundred_units(density: float) -> None:
    world = simulate_figure_eight(density=density, iterations=50)
    assert len(world.landmarks_map) == round(7.4 * density)
    assert len(world.log.points_robot) / 50 == pytest.approx(0.8 * density, rel=0.4)


def test_noise_has_the_given_standard_deviation() -> None:
    gaussian = errors(simulate_figure_eight(sigma=0.3, noise="gaussian"))
    uniform = errors(simulate_figure_eight(sigma=0.3, noise="uniform"))
    for drawn in (gaussian, uniform):
        np.testing.assert_allclose(drawn.std(axis=0), 0.3, rtol=0.02)
        np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.01)
    assert np.abs(uniform).max() <= 0.3 * np.sqrt(3)
    assert np.abs(gaussian).max() > 0.3 * np.sqrt(3)


def test_without_noise_the_observations_are_exact() -> None:
    assert np.abs(errors(simulate_figure_eight(sigma=0.0))).max() < 1e-12


def test_the_sensor_sees_ahead_within_its_range() -> None:
    points = simulate_figure_eight(sigma=0.0, density=100).log.points_robot
    distance = np.linalg.norm(points, axis=1)
    assert distance.max() <= eight.RANGE_M
    assert (points[:, 0] >= distance * np.cos(eight.HALF_VIEW_RAD) - 1e-9).all()


def test_a_seed_gives_the_same_run_and_another_seed_another() -> None:
    first, second = (
        simulate_figure_eight(dynamic=0.3, seed=4),
        simulate_figure_eight(dynamic=0.3, seed=4),
    )
    assert first.log.points_robot.tobytes() == second.log.points_robot.tobytes()
    other = simulate_figure_eight(dynamic=0.3, seed=5)
    assert first.landmarks_map.tobytes() != other.landmarks_map.tobytes()


def test_the_share_of_dynamic_landmarks_is_kept_and_they_move() -> None:
    world = simulate_figure_eight(dynamic=0.4, sigma=0.0)
    moving = world.status == "dynamic"
    assert moving.sum() == round(0.4 * len(moving))
    log = world.log
    assert log.ids is not None
    T = world.trajectory[log.iteration]
    in_map = np.einsum("nij,nj->ni", T[:, :3, :3], log.points_robot) + T[:, :3, 3]
    for landmark in world.landmark_ids:
        spread = np.ptp(in_map[log.ids == landmark], axis=0).max(initial=0)
        assert (spread > 0.5) == moving[landmark]


def test_every_kind_of_motion_is_there_and_stays_in_reach() -> None:
    offsets = dynamic_offsets(8, 500, np.random.default_rng(0))
    speed = np.linalg.norm(np.diff(offsets, axis=0), axis=2)
    assert np.abs(offsets).max() <= REACH_M + 1e-9
    to_and_fro, walk, circle, stop_and_go = speed[:, 0], speed[:, 1], speed[:, 2], speed[:, 3]
    assert np.ptp(np.quantile(to_and_fro, [0.2, 0.9])) < 1e-9
    assert walk.std() > 0.2 * walk.mean()
    np.testing.assert_allclose(np.linalg.norm(offsets[:, 2], axis=1), np.hypot(*offsets[0, 2, :2]))
    assert circle.min() > 0
    assert 0.2 < np.mean(stop_and_go == 0) < 0.8


@pytest.mark.parametrize(
    "bad",
    [
        {"density": 0.0},
        {"density": float("nan")},
        {"iterations": 0},
        {"noise": "pink"},
        {"sigma": -1.0},
        {"dynamic": 1.5},
        {"seed": -1},
    ],
)
def test_arguments_out_of_range_are_named(bad: dict[str, object]) -> None:
    with pytest.raises(RelmapError, match=next(iter(bad))):
        simulate_figure_eight(**bad)  # type: ignore[arg-type]
