from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from relmap import RelmapError
from relmap.cli import main
from relmap.datasets import open_log
from relmap.simulation import WorldSpec, simulate_world
from relmap.simulation.places import KINDS
from relmap.simulation.worlds import REACH_M, SENSORS, World, covariances_of

SMALL = WorldSpec(length_m=200.0, iterations=80)


def true_points(world: World) -> np.ndarray:
    """Return where each true detection (n, d) would be without noise."""
    own = world.true_ids >= 0
    T = world.trajectory[world.log.iteration[own]]
    away = world.landmarks_map[world.true_ids[own]] - T[:, :3, 3]
    points = np.einsum("nij,ni->nj", T[:, :3, :3], away)
    return np.asarray(points[:, : world.log.points_robot.shape[1]])


@pytest.mark.parametrize("kind", KINDS)
def test_without_noise_every_world_is_seen_as_it_is(kind: str) -> None:
    world = simulate_world(replace(SMALL, kind=kind, sigma=0.0))
    points = world.log.points_robot
    np.testing.assert_allclose(points, true_points(world), atol=1e-9)
    assert np.linalg.norm(points, axis=1).max() <= REACH_M
    assert np.abs(np.arctan2(np.linalg.norm(points[:, 1:], axis=1), points[:, 0])).max() <= 1.05
    assert len(np.unique(world.log.iteration)) >= 0.95 * SMALL.iterations
    np.testing.assert_array_equal(world.log.ids, world.true_ids)


@pytest.mark.parametrize("noise", SENSORS)
def test_noise_agrees_with_its_covariances(noise: str) -> None:
    world = simulate_world(replace(SMALL, space=True, noise=noise, sigma=0.02))
    errors = world.log.points_robot - true_points(world)
    whitened = np.linalg.solve(np.linalg.cholesky(world.covariances), errors[:, :, None])[:, :, 0]
    np.testing.assert_allclose(np.cov(whitened.T), np.eye(3), atol=0.1)


def test_noise_of_the_range_is_along_the_ray() -> None:
    covariance = covariances_of(np.array([[0.0, 10.0]]), 0.1, "range")[0]
    np.testing.assert_allclose(covariance, np.diag([0.01, 1.0]), atol=1e-12)


def test_detections_are_missed_and_made_up() -> None:
    whole = simulate_world(SMALL)
    world = simulate_world(replace(SMALL, missed=0.3, spurious=0.2))
    n = len(whole.true_ids)
    assert np.sum(world.true_ids >= 0) / n == pytest.approx(0.7, abs=0.05)
    assert np.sum(world.true_ids < 0) / n == pytest.approx(0.2, abs=0.05)
    assert np.linalg.norm(world.log.points_robot, axis=1).max() < REACH_M + 1


def test_wrong_ids_occur_once_in_a_scan() -> None:
    world = simulate_world(replace(SMALL, wrong_ids=0.1))
    assert np.mean(world.log.ids != world.true_ids) == pytest.approx(0.1, abs=0.03)
    pairs = np.column_stack([world.log.iteration, world.log.ids])
    assert len(np.unique(pairs, axis=0)) == len(pairs)


def test_the_sensor_turns() -> None:
    world = simulate_world(replace(SMALL, kind="line", turn_deg=40.0))
    R = world.trajectory[:, :3, :3]
    cosine = np.einsum("kii->k", R[1:] @ np.swapaxes(R[:-1], 1, 2)) / 2 - 0.5
    np.testing.assert_allclose(np.rad2deg(np.arccos(cosine)), 40.0, atol=1e-6)


def test_the_way_of_streets_closes_loops() -> None:
    at = simulate_world(SMALL).trajectory[:, :3, 3]
    np.testing.assert_allclose(at[0], at[-1], atol=2.0)


@pytest.mark.parametrize(
    "wrong", [{"kind": "moon"}, {"noise": "pink"}, {"missed": 1.0}, {"turn_deg": -1.0}]
)
def test_what_cannot_be_simulated_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(RelmapError, match=str(next(iter(wrong.values())))):
        simulate_world(replace(SMALL, **wrong))  # type: ignore[arg-type]


def test_the_command_writes_what_the_contract_says(tmp_path: Path) -> None:
    options = ["--kind", "corridor", "--iterations", "30", "--length", "80", "--spurious", "0.1"]
    assert main(["simulate", "world", "-o", str(tmp_path / "a"), *options]) == 0
    assert main(["simulate", "world", "-o", str(tmp_path / "b"), *options]) == 0
    for name in ("observations.csv", "truth/landmarks.csv", "truth/trajectory.tum"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    log = open_log(tmp_path / "a")
    lines = (tmp_path / "a" / "truth" / "ids.csv").read_text().split()
    assert lines[0] == "row,landmark"
    assert len(lines) == len(log.points_robot) + 1
