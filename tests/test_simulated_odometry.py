"""Simulated odometry: its noise, its biases, its faults, and its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from benchmarks.shared.log_faults import big_step
from relmap.cli import main
from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.odometry import checked_odometry
from relmap.datasets import open_log, open_scans
from relmap.datasets.odometry import motions, path_of
from relmap.evaluation.truth import read_truth
from relmap.simulation import simulate_figure_eight
from relmap.simulation.odometry import (
    Wheels,
    backward,
    slipping,
    stale,
    wheel_odometry,
)
from tests.scanlogs import planar

Poses = Floats
EXACT = Wheels(way=0.0, turn_deg=0.0)


def circle(k: int = 4000, step_m: float = 0.5) -> Poses:
    """Return poses (k, 4, 4) of a robot that turns by 0.01 rad a step."""
    return path_of(np.tile(checked_odometry([step_m, 0, 0.01]), (k, 1, 1)))


def errors(odometry: Poses, poses: Poses) -> tuple[Floats, Floats]:
    """Return by how much each step (k - 1, 3) and its turn (k - 1, 3), radians, are off."""
    true = motions(poses)[1:]
    back = Rotation.from_matrix(true[:, :3, :3]).inv()
    turn = back * Rotation.from_matrix(odometry[1:, :3, :3])
    return odometry[1:, :3, 3] - true[:, :3, 3], turn.as_rotvec()


def test_noise_has_the_given_size() -> None:
    poses, wheels = circle(), Wheels(way=0.02, turn_deg=0.1, turn_deg_per_m=0.4)
    step, turn = errors(wheel_odometry(poses, wheels, np.random.default_rng(1)), poses)
    assert_allclose(step[:, :2].std(axis=0), 0.02 * 0.5, rtol=0.05)
    assert_allclose(np.rad2deg(turn[:, 2].std()), 0.1 + 0.4 * 0.5, rtol=0.05)
    assert not step[:, 2].any()
    assert not turn[:, :2].any()
    assert np.abs(step.mean(axis=0)).max() < 0.001


def test_in_space_all_six_are_noisy() -> None:
    poses = simulate_figure_eight(density=1, iterations=900).trajectory
    odometry = wheel_odometry(poses, Wheels(), np.random.default_rng(1))
    step, turn = errors(odometry, poses)
    way = np.linalg.norm(motions(poses)[1:, :3, 3], axis=1)
    assert_allclose((step / way[:, None]).std(axis=0), 0.01, rtol=0.1)
    assert_allclose(np.rad2deg(turn.std(axis=0)), 0.1, rtol=0.1)
    assert np.isnan(odometry[0]).all()


def test_biases_add_up() -> None:
    wheels = replace(EXACT, way_bias=0.03, turn_bias_deg_per_m=0.2)
    poses = circle(100)
    step, turn = errors(wheel_odometry(poses, wheels, np.random.default_rng(0)), poses)
    assert_allclose(step, [[0.015, 0, 0]] * 99, atol=1e-12)
    assert_allclose(np.rad2deg(turn.sum(axis=0)), [0, 0, 0.2 * 0.5 * 99], atol=1e-9)


def test_without_error_it_is_the_truth() -> None:
    poses = circle(50)
    odometry = wheel_odometry(poses, EXACT, np.random.default_rng(0))
    assert_allclose(odometry[1:], motions(poses)[1:], atol=1e-12)


@pytest.mark.parametrize("name", ["way", "turn_deg", "turn_deg_per_m", "way_bias"])
def test_noise_out_of_range_is_refused(name: str) -> None:
    with pytest.raises(RelmapError, match=f"{name} of wheels is nan"):
        replace(EXACT, **{name: float("nan")})


def test_slips_double_the_way_of_a_tenth_of_the_steps() -> None:
    odometry = motions(circle(200))
    slipped = slipping(odometry, 0.1, np.random.default_rng(0))
    ratio = slipped[1:, 0, 3] / odometry[1:, 0, 3]
    assert sorted({*ratio.round(9).tolist()}) == [1, 2]
    assert (ratio > 1.5).sum() in (19, 20)
    assert_array_equal(slipped[:, :3, :3], odometry[:, :3, :3])


def test_reversed_odometry_goes_back() -> None:
    odometry = motions(circle(20))
    back = backward(odometry)
    assert_allclose(back[1:] @ odometry[1:], [np.eye(4)] * 19, atol=1e-14)
    assert np.isnan(back[0]).all()


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_stale_odometry_is_that_of_before(rate: float) -> None:
    rng = np.random.default_rng(0)
    steps = np.array([checked_odometry([s, 0, t]) for s, t in rng.uniform(0, 1, (30, 2))])
    steps[0] = np.nan
    late = stale(steps, np.arange(30) / rate, 3 / rate)
    assert np.isnan(late[:4]).all()
    assert_allclose(late[4:], steps[1:-3], atol=1e-12)
    straight = motions(path_of(np.tile(checked_odometry([1, 0, 0]), (9, 1, 1))))
    half = stale(straight, np.arange(9.0), 0.5)
    assert planar(half[2:]) == [[1, 0, 0]] * 7
    steps[10] = np.nan
    unknown = stale(steps, np.arange(30.0), 3.0)
    assert np.isnan(unknown[13]).all()
    assert_allclose(unknown[15:], late[15:], atol=1e-12)


def test_a_big_step_adds_motions_up() -> None:
    world = simulate_figure_eight(density=20, iterations=12)
    log = replace(world.log, odometry=motions(world.trajectory))
    far = big_step(log, 4, 3)
    kept = world.trajectory[[0, 1, 2, 3, 4, 7, 8, 9, 10, 11]]
    assert_allclose(far.odometry[1:], motions(kept)[1:], atol=1e-12)


WORLDS = {
    "figure-eight": ["figure-eight", "--iterations", "30", "--density", "10"],
    "world": ["world", "--iterations", "30", "--length", "60"],
    "building": ["building", "--iterations", "30", "--beams", "90"],
}


@pytest.mark.parametrize("name", WORLDS)
def test_simulate_writes_odometry(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, moved = tmp_path / "plain", tmp_path / "moved"
    assert main(["simulate", *WORLDS[name], "-o", str(plain)]) == 0
    options = ["--odometry", "0.01:0.1", "--odometry-bias", "0.02:0"]
    assert main(["simulate", *WORLDS[name], "-o", str(moved), *options]) == 0
    written = {path.relative_to(moved) for path in moved.rglob("*") if path.is_file()}
    said = capsys.readouterr().out.splitlines()[-1]
    assert f"wrote {len(written)} files" in said
    assert written - {Path("odometry.csv")} == {
        path.relative_to(plain) for path in plain.rglob("*") if path.is_file()
    }
    for path in plain.rglob("*.csv"):
        assert path.read_bytes() == (moved / path.relative_to(plain)).read_bytes()
    log = open_scans(moved) if name == "building" else open_log(moved)
    assert log.odometry is not None
    variant = "planes" if name == "building" else "points"
    poses = read_truth(moved, variant).poses  # type: ignore[arg-type]
    step, turn = errors(log.odometry, poses)
    way = motions(poses)[1:, 0, 3]
    assert_allclose((step[:, 0] / way)[way > 0.1].mean(), 0.02, atol=0.006)
    assert np.rad2deg(np.abs(turn).max()) < 0.5
    assert main(["simulate", *WORLDS[name], "--seed", "1", "-o", str(moved)]) == 0
    assert not (moved / "odometry.csv").exists()  # it was of the path before


def test_a_single_scan_has_no_odometry(tmp_path: Path) -> None:
    command = ["simulate", "figure-eight", "--iterations", "1", "--odometry", "0.01:0.1"]
    assert main([*command, "-o", str(tmp_path)]) == 0
    assert not (tmp_path / "odometry.csv").exists()
    assert len(open_log(tmp_path)) == 1


@pytest.mark.parametrize("fault", ["slip", "reversed", "stale"])
def test_simulate_writes_faults(fault: str, tmp_path: Path) -> None:
    command = ["simulate", *WORLDS["figure-eight"], "--odometry", "0:0", "--odometry-fault", fault]
    assert main([*command, "-o", str(tmp_path)]) == 0
    odometry = open_log(tmp_path).odometry
    true = motions(read_truth(tmp_path).poses)
    assert odometry is not None
    expected = {
        "slip": None,
        "reversed": backward(true),
        "stale": stale(true, np.arange(30.0), 3.0),
    }[fault]
    if expected is None:
        ratio = odometry[1:, 0, 3] / true[1:, 0, 3]
        assert (np.abs(ratio - 2) < 1e-9).sum() in (2, 3)
    else:
        assert_allclose(odometry, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--odometry", "0.01"], "'0.01' must be WAY:TURN, two numbers"),
        (["--odometry", "0.01:inf"], "must be WAY:TURN, two numbers"),
        (["--odometry", "-1:0"], "way of wheels is -1.0; it must lie in"),
        (["--odometry-bias", "0:1"], "require --odometry"),
        (["--odometry-fault", "slip"], "require --odometry"),
    ],
)
def test_simulate_refuses_wheels(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", *WORLDS["figure-eight"], "-o", str(tmp_path / "a"), *options]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
