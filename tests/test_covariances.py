"""Covariances of observations: validation, effect on the map, and storage."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from relmap import MapperConfig, PointMapper, RelmapError, range_bearing_covariances
from relmap.cli import main
from relmap.core.arrays import Floats
from relmap.datasets import ObservationLog, open_log, write_observation_csv
from relmap.simulation.worlds import World, WorldSpec, simulate_world
from tests.commands import load
from tests.worlds import aligned_rmse, ate_m, refined, turn, walk

pytestmark = pytest.mark.usefixtures("unrendered")

Array = Floats


@cache
def world(noise: str, kind: str = "streets", space: bool = False) -> World:
    return simulate_world(
        WorldSpec(kind=kind, noise=noise, length_m=150, iterations=100, space=space, seed=3)
    )


def mapped(log: ObservationLog) -> PointMapper:
    return refined(
        PointMapper(), ((scan.points_robot, scan.ids, scan.covariances) for scan in log.scans())
    )


def error(mapper: PointMapper, truth: World) -> float:
    d = truth.log.points_robot.shape[1]
    found = mapper.map
    return aligned_rmse(found.positions[:, :d], truth.landmarks_map[found.landmark_ids, :d])


def path_error(mapper: PointMapper, truth: World) -> float:
    known = np.isfinite(mapper.trajectory[:, 0, 0])
    return ate_m(mapper.trajectory[known], truth.trajectory[known])


@pytest.mark.parametrize(("noise", "gain"), [("bearing", 2.0), ("stereo", 2.0), ("growing", 1.1)])
@pytest.mark.parametrize("space", [False, True])
@pytest.mark.parametrize("given", [True, False])
def test_a_map_gains_by_covariances(noise: str, gain: float, space: bool, given: bool) -> None:
    """Given or estimated, over equal ones."""
    truth = world(noise, space=space)
    equal = np.broadcast_to(np.eye(truth.covariances.shape[1]), truth.covariances.shape)
    plain = mapped(replace(truth.log, covariances=equal))
    weighed = mapped(replace(truth.log, covariances=truth.covariances if given else None))
    assert len(weighed.map.positions) == len(plain.map.positions)
    assert error(weighed, truth) * gain < error(plain, truth)
    assert path_error(weighed, truth) * gain < path_error(plain, truth)


def test_equal_covariances_change_next_to_nothing() -> None:
    truth = world("isotropic")
    plain = mapped(truth.log)
    weighed = mapped(replace(truth.log, covariances=truth.covariances))
    assert aligned_rmse(weighed.map.positions, plain.map.positions) < 0.1 * error(plain, truth)
    assert error(weighed, truth) == pytest.approx(error(plain, truth), rel=0.02)


def weighed_least_squares(log: ObservationLog, start: Array) -> Array:
    """Return the landmarks (m, 2), by an independent solver."""
    assert log.ids is not None
    roots = np.linalg.inv(np.linalg.cholesky(log.covariances))
    k, m = len(log), len(start)

    def residuals(unknown: Array) -> Array:
        poses, landmarks = unknown[: 3 * k].reshape(k, 3), unknown[3 * k :].reshape(m, 2)
        R = turn(poses[:, 2])
        away = landmarks[log.ids] - poses[log.iteration, :2]
        off = np.einsum("nji,nj->ni", R[log.iteration], away) - log.points_robot
        return np.asarray(np.einsum("nij,nj->ni", roots, off).ravel())

    found = least_squares(residuals, np.append(np.zeros(3 * k), start.ravel()), x_scale="jac")
    return np.asarray(found.x[3 * k :].reshape(m, 2))


def test_the_map_is_that_of_weighted_least_squares() -> None:
    rng = np.random.default_rng(4)
    landmarks = rng.uniform(-10, 10, (15, 2))
    points = np.concatenate([landmarks - [0.1 * k, 0.0] for k in range(12)])
    covariances = range_bearing_covariances(points, 0.01, 0.05)
    noise = np.linalg.cholesky(covariances) @ rng.normal(size=(len(points), 2, 1))
    ids, iteration = np.tile(np.arange(15), 12), np.repeat(np.arange(12), 15)
    parts = points + noise[:, :, 0], iteration, np.arange(180), 0, 12, ids
    log = ObservationLog(*parts, covariances=covariances)
    expected = weighed_least_squares(log, landmarks)
    mapper = mapped(log)
    assert mapper.map.landmark_ids.tolist() == list(range(15))
    assert aligned_rmse(mapper.map.positions[:, :2], expected) < 1e-4
    plain = mapped(replace(log, covariances=None)).map
    assert aligned_rmse(plain.positions[:, :2], expected[plain.landmark_ids]) > 0.01


def test_covariances_of_the_map_agree_with_its_errors() -> None:
    truth = world("bearing")
    mapper = mapped(replace(truth.log, covariances=truth.covariances))
    assert len(mapper.refined) == 1
    refined = mapper.refined[0]
    anchor = truth.trajectory[refined.anchor_iteration]
    ids = mapper.engine.association.current.labels_of(refined.landmarks)
    there = (truth.landmarks_map[ids] - anchor[:3, 3]) @ anchor[:3, :3]
    off = refined.positions - there[:, :2]
    squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(refined.covariances), off)
    # The errors of neighbours are nearly the same: their number is far from that of landmarks.
    assert 0.2 < np.mean(squares) / 2 < 4
    scaled = mapped(replace(truth.log, covariances=100 * truth.covariances))
    np.testing.assert_allclose(scaled.refined[0].covariances, refined.covariances, rtol=1e-3)


BAD = {
    "shape": np.ones((4, 2)),
    "a nan": np.full((4, 2, 2), np.nan),
    "symmetric": np.tile([[1.0, 0.5], [0.0, 1.0]], (4, 1, 1)),
    "positive definite": np.tile([[1.0, 2.0], [2.0, 1.0]], (4, 1, 1)),
    "positive  definite": np.zeros((4, 2, 2)),
    "between 1e-30 and": np.tile(1e-300 * np.eye(2), (4, 1, 1)),
    "and 1e.30": np.tile(1e31 * np.eye(2), (4, 1, 1)),
    "array of numbers": np.full((4, 2, 2), "x"),
}


@pytest.mark.parametrize("unit", [2.0**-10, 2.0**10])
def test_a_map_and_its_covariances_do_not_depend_on_the_unit(unit: float) -> None:
    scans = walk(3, 5, 0.02, iterations=200).scans
    each = [np.broadcast_to(4e-4 * np.eye(3), (len(ids), 3, 3)) for ids, _ in scans]
    given = [(points, ids, own) for (ids, points), own in zip(scans, each, strict=True)]
    plain = refined(PointMapper(), given).map
    scaled = refined(
        PointMapper(), ((unit * points, ids, unit**2 * own) for points, ids, own in given)
    ).map
    np.testing.assert_allclose(scaled.positions, unit * plain.positions, rtol=0, atol=1e-7 * unit)
    variances = np.trace(plain.covariances, axis1=1, axis2=2)
    of_scaled = np.trace(scaled.covariances, axis1=1, axis2=2)
    np.testing.assert_allclose(of_scaled, unit**2 * variances, rtol=1e-3)


@pytest.mark.parametrize("what", BAD)
def test_bad_covariances_are_refused_and_change_nothing(what: str) -> None:
    mapper, points = PointMapper(), np.arange(8.0).reshape(4, 2) ** 2
    message = {"a nan": "finite", "positive  definite": "positive definite"}.get(what, what)
    with pytest.raises(RelmapError, match=f"covariances .*{message}"):
        mapper.update(points, covariances=BAD[what])
    assert mapper.n_iterations == 0
    mapper.update(points, covariances=np.tile(np.eye(2), (4, 1, 1)))


def test_covariances_come_with_every_scan_or_none() -> None:
    points, eye = np.arange(8.0).reshape(4, 2) ** 2, np.tile(np.eye(2), (4, 1, 1))
    for first, then, message in ((eye, None, "came with"), (None, eye, "did not come with")):
        mapper = PointMapper()
        mapper.update(np.empty((0, 2)))
        mapper.update(points, covariances=first)
        mapper.update(np.empty((0, 2)))
        with pytest.raises(RelmapError, match=f"covariances {message} earlier scans"):
            mapper.update(points, covariances=then)
        assert mapper.n_iterations == 3
        mapper.update(points, covariances=first)


@pytest.mark.parametrize("dimension", [2, 3])
def test_journal_and_saved_state_keep_covariances(tmp_path: Path, dimension: int) -> None:
    scans = walk(dimension, 1, sigma=0.05).scans
    noise = [range_bearing_covariances(points, 0.05, 0.01) for _, points in scans]
    mapper = PointMapper(journal=tmp_path / "journal")
    mapper.update(np.empty((0, dimension)))
    for (ids, points), covariances in zip(scans[:60], noise, strict=False):
        mapper.update(points, ids, covariances)
    mapper.save(tmp_path / "saved.npz")
    mapper.close()
    resumed = PointMapper.resume(tmp_path / "journal")
    loaded = PointMapper.load(tmp_path / "saved.npz")
    positions = []
    for each in (mapper, resumed, loaded):
        for (ids, points), covariances in zip(scans[60:], noise[60:], strict=True):
            each.update(points, ids, covariances)
        each.finish()
        each.refine()
        positions.append(each.map.positions)
    resumed.close()
    np.testing.assert_array_equal(positions[1], positions[0])
    np.testing.assert_array_equal(positions[2], positions[0])
    again = PointMapper.resume(tmp_path / "journal")
    np.testing.assert_array_equal(again.engine.kept.covariance, mapper.engine.kept.covariance)
    again.close()


def test_a_log_keeps_covariances(tmp_path: Path) -> None:
    for space in (False, True):
        truth = world("bearing", space=space)
        log = replace(truth.log, covariances=truth.covariances)
        path = tmp_path / f"{space}.csv"
        write_observation_csv(path, log)
        again = open_log(path)
        np.testing.assert_array_equal(again.points_robot, log.points_robot)
        np.testing.assert_allclose(again.covariances, truth.covariances, rtol=1e-9)
        part = again.between(5, 9)
        assert len(part.covariances) == len(part.points_robot)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("iteration,x,y,cxx,cyy\n0,1,2,1,1\n", "need the columns cxx, cxy, cyy"),
        ("iteration,x,y,cxx,cxy,cyy\n0,1,2,1,2,1\n", "positive definite"),
        ("iteration,x,y,cxx,cxy,cyy\n0,1,2,nan,0,1\n", "line 2, field cxx"),
    ],
)
def test_bad_covariances_of_a_log_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "observations.csv").write_text(text)
    with pytest.raises(RelmapError, match=message):
        open_log(tmp_path)


def test_the_command_line_weighs_observations(tmp_path: Path) -> None:
    truth = world("bearing")
    write_observation_csv(tmp_path / "observations.csv", truth.log)
    command = ["map", str(tmp_path / "observations.csv"), "--association", "known", "-o"]
    sigmas = ["--range-sigma", "0.05", "--bearing-sigma", "0.04"]
    errors = []
    for name, options in (("plain", []), ("weighed", sigmas)):
        journal = str(tmp_path / f"{name}.journal")
        assert main([*command, str(tmp_path / name), *options, "--journal", journal]) == 0
        summary = load(tmp_path / name / "summary.json")
        assert summary["weighed"] == bool(options)
        found = np.genfromtxt(tmp_path / name / "landmarks.csv", delimiter=",", names=True)
        positions = np.column_stack([found["x"], found["y"]])
        there = truth.landmarks_map[found["landmark"].astype(int), :2]
        errors.append(aligned_rmse(positions, there))
        assert main(["resume", journal, "-o", str(tmp_path / f"{name}-again")]) == 0
        one, other = (tmp_path / f / "landmarks.csv" for f in (name, f"{name}-again"))
        assert one.read_bytes() == other.read_bytes()
    equal = np.broadcast_to(np.eye(2), truth.covariances.shape)
    unweighed = error(mapped(replace(truth.log, covariances=equal)), truth)
    assert max(errors) < 0.6 * unweighed


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--range-sigma", "0.1"], "must be given together"),
        (["--bearing-sigma", "0.1"], "must be given together"),
        (["--range-sigma", "0", "--bearing-sigma", "0.1"], "above 0"),
        (["--range-sigma", "nan", "--bearing-sigma", "0.1"], "above 0"),
        (["--range-sigma", "1", "--bearing-sigma", ".1", "--elevation-sigma", ".1"], "planar"),
        (["--range-sigma", "1", "--bearing-sigma", "1", "--variant", "planes"], "walls"),
    ],
)
def test_sigmas_that_cannot_be_used_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    write_observation_csv(tmp_path / "observations.csv", world("bearing").log)
    source = str(tmp_path / "observations.csv")
    assert main(["map", source, "-o", str(tmp_path / "r"), *options]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("weighed", [True, False], ids=["covariances", "powers"])
def test_the_frame_is_that_of_the_first_scan_that_the_mapped_landmarks_determine(
    weighed: bool,
) -> None:
    rng = np.random.default_rng(0)
    world = rng.uniform(-9.0, 9.0, (14, 2))
    mapper = PointMapper(MapperConfig(keep_observations=not weighed))
    for k in range(40):
        # The first scan shows one of those that stay, and two others.
        seen = np.arange(14)[slice(0 if k < 2 else 2, 3 if k == 0 else 14)]
        points = world[seen] - [0.1 * k, 0.0] + rng.uniform(-0.02, 0.02, (len(seen), 2))
        noise = np.tile(np.diag([1e-4, 4e-4]), (len(seen), 1, 1))
        mapper.update(points, covariances=noise if weighed else None)
    mapper.finish()
    mapper.refine()
    assert mapper.refined[0].anchor_iteration == 1
    pose = mapper.trajectory[1]
    np.testing.assert_allclose(pose, np.eye(4), atol=0.01)


@pytest.mark.parametrize("along", [True, False], ids=["bearings", "ranges"])
def test_scans_with_nearly_exact_bearings_or_ranges_are_matched(along: bool) -> None:
    rng, mapper = np.random.default_rng(1), PointMapper()
    world = rng.uniform(-20.0, 20.0, (100, 2))
    for k in range(70):
        yaw = 2 * np.pi * k / 70
        points = (world - 13.0 * np.array([np.cos(yaw), np.sin(yaw)])) @ turn(yaw)
        points = points[np.linalg.norm(points, axis=1) < 12.0]
        ray = points / np.linalg.norm(points, axis=1)[:, None]
        noisy = ray if along else ray[:, ::-1] * [-1.0, 1.0]
        exact = 1e-6 * np.eye(2)
        points += 0.05 * rng.normal(size=(len(points), 1)) * noisy
        mapper.update(points, covariances=0.05**2 * noisy[:, :, None] * noisy[:, None] + exact**2)
    mapper.finish()
    assert not len(mapper.rejected)
    assert len(mapper.map.positions) >= 100
