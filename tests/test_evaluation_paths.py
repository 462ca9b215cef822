"""What makes the errors of a path misleading: the times, the axes and the unit of the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from relmap.cli import main
from relmap.core.arrays import Floats
from relmap.core.geometry.motions import transforms
from relmap.evaluation.evaluate import Evaluation, evaluate
from relmap.evaluation.truth import Truth
from relmap.io.files import read_tum, write_tum
from relmap.io.results import Result
from tests.commands import load
from tests.somerun import make_result

K = 60
CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Axes of a camera (x right, y down, z ahead) in the frame of the robot."""
SECONDS = np.arange(float(K))


def drive(sigma_m: float = 0.0) -> Floats:
    """Return poses (k, 4, 4) along a curve in the plane, with noise of the positions."""
    turn = 0.02 * np.arange(K)
    c, s = np.cos(turn), np.sin(turn)
    poses = np.tile(np.eye(4), (K, 1, 1))
    poses[:, :2, :2] = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
    at = np.cumsum(0.1 * np.column_stack([c, s]), axis=0)
    poses[:, :2, 3] = at + np.random.default_rng(0).normal(0, sigma_m, (K, 2))
    return poses


def judged(
    poses: Floats, true_s: Floats, true_poses: Floats, dimensions: int = 2, submaps: int = 1
) -> Evaluation:
    summary = {"dimensions": dimensions, "counts": {"iterations": 90}, "submaps": [{}] * submaps}
    result: Result = replace(make_result(9, True), stamps_s=SECONDS, poses=poses, summary=summary)
    return evaluate(result, Truth(stamps_s=true_s, poses=true_poses))


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("sigma_m", [0.005, 0.05])
def test_the_axes_of_a_camera_give_no_relative_error(dimensions: int, sigma_m: float) -> None:
    found, right = drive(sigma_m), judged(drive(sigma_m), SECONDS, drive(), dimensions)
    turned = judged(found, SECONDS, drive() @ CAMERA, dimensions)
    assert right.notes == ()
    assert turned.ate_m == right.ate_m
    assert turned.rpe_m is None
    (note,) = turned.notes
    assert note.startswith("no RPE: the poses of the truth have other axes")
    assert float(note.split()[-2]) == pytest.approx(right.rpe_m, rel=0.2)


def test_a_path_in_the_frame_of_a_camera_gives_no_planar_error() -> None:
    right = judged(drive(0.01), SECONDS, drive())
    truth = np.linalg.inv(CAMERA) @ drive() @ CAMERA
    turned = judged(drive(0.01), SECONDS, truth)
    assert turned.ate_m is turned.rpe_m is None
    note, other = turned.notes
    assert note.startswith("no ATE: the true path lies in another plane than that of x and y")
    assert float(note.split()[-2]) == pytest.approx(right.ate_m, rel=0.1)
    assert other.startswith("no RPE")
    in_space = judged(drive(0.01), SECONDS, truth, dimensions=3)
    assert in_space.ate_m == pytest.approx(right.ate_m, rel=0.1)


def test_a_mirrored_path_is_said_to_be_one() -> None:
    right, mirror = judged(drive(0.01), SECONDS, drive()), np.diag([1.0, -1.0, 1.0, 1.0])
    mirrored = judged(mirror @ drive(0.01) @ mirror, SECONDS, drive())
    assert mirrored.ate_m > 10 * right.ate_m
    note = mirrored.notes[0]
    assert note.startswith("the path is the mirror image of the true one: y and bearings must be")
    assert float(note.split()[-2]) == pytest.approx(right.ate_m, abs=1e-4)


@pytest.mark.parametrize("scale", [1.0, 0.0])
@pytest.mark.parametrize("sigma_m", [0.0, 0.001, 0.05, 1.0])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_errors_of_the_map_are_not_taken_for_other_axes(
    scale: float, sigma_m: float, dimensions: int
) -> None:
    truth = drive()
    truth[:, :3, 3] *= scale  # 0: the robot stands still
    found = truth.copy()
    rng = np.random.default_rng(1)
    found[:, :dimensions, 3] += rng.normal(0, sigma_m, (K, dimensions))
    mount = transforms(np.array([[0.985, -0.174], [0.174, 0.985]]), np.array([0.3, 0.1]))
    for true_poses in (truth, truth @ mount):
        evaluation = judged(found, SECONDS, true_poses, dimensions)
        assert evaluation.ate_m is not None
        assert evaluation.rpe_m is not None
        assert not [note for note in evaluation.notes if note.startswith("no ")]


def test_clocks_with_hardly_a_common_time_give_no_error() -> None:
    evaluation = judged(drive(0.01), 1e3 * SECONDS, drive())
    assert evaluation.ate_m is evaluation.rpe_m is None
    said = "no ATE and no RPE: only 1 of 60 poses have the times of true ones"
    assert evaluation.notes == (f"{said} (0 to 59 s, true: 0 to 59000 s)",)


def test_the_errors_of_a_part_are_said_to_be() -> None:
    evaluation = judged(drive(0.01), SECONDS[:20], drive()[:20])
    assert evaluation.ate_m is not None
    assert evaluation.notes[0].startswith("ATE and RPE are of a part of the path: 20 of 60 poses")
    evaluation = judged(drive(0.01), SECONDS, drive(), submaps=3)
    said = "the path is that of the map, the first of 3 submaps: 60 of 90 scans"
    assert evaluation.notes == (said,)


def test_a_path_in_millimetres_is_noticed() -> None:
    truth = drive()
    truth[:, :3, 3] *= 1000
    (note,) = judged(drive(), SECONDS, truth).notes
    assert note.startswith("the true path is 1000 times as large as that of the result")


@pytest.mark.usefixtures("in_process", "unrendered")
def test_planes_in_space_are_not_judged_in_the_axes_of_a_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "storey", "-o", "rooms", "--iterations", "10"]) == 0
    assert main(["map", "rooms", "-o", "out", "--variant", "planes3d"]) == 0
    path = tmp_path / "rooms" / "truth" / "trajectory.tum"
    assert main(["evaluate", "out", "--truth", "rooms"]) == 0
    right = load(tmp_path / "out" / "evaluation.json")
    assert right["plane_recall"] > 0.9
    stamps_s, poses = read_tum(path)
    write_tum(path, stamps_s, poses @ CAMERA)
    assert main(["evaluate", "out", "--truth", "rooms"]) == 0
    turned = load(tmp_path / "out" / "evaluation.json")
    assert turned["plane_recall"] is turned["plane_precision"] is turned["rpe_m"] is None
    assert turned["ate_m"] == pytest.approx(right["ate_m"])
    assert "no plane recall, precision and RMSE" in capsys.readouterr().out


@pytest.mark.usefixtures("in_process", "unrendered")
def test_compare_says_why_figures_are_missing_and_that_ids_are_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "figure-eight", "-o", "eight", "--iterations", "20"]) == 0
    write_tum(tmp_path / "late.tum", SECONDS + 1000, drive())
    run = ["compare", "eight", "--truth", "late.tum", "--methods", "relmap-points", "-o", "c"]
    assert main([*run, "--association", "nearest"]) == 0
    said = capsys.readouterr().out
    assert "eight; association nearest, the ids of the log are not used\n" in said
    assert "\nrelmap-points: no ATE and no RPE: no pose of the result has the time" in said
