"""Trajectories as a truth: in the formats of TUM and KITTI, for points and for walls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from relmap.cli import main
from relmap.core.errors import RelmapError
from relmap.evaluation.truth import Variant, read_truth
from relmap.io.files import read_tum, write_tum
from relmap.simulation import simulate_figure_eight
from tests.commands import load, table
from tests.logs import put
from tests.scanlogs import CORRECTED

pytestmark = pytest.mark.usefixtures("unrendered")

POSES = simulate_figure_eight(density=1, iterations=20).trajectory


def kitti(folder: Path) -> Path:
    rows = POSES[:, :3].reshape(-1, 12).tolist()
    return put(folder, "".join(" ".join(map(repr, row)) + "\n" for row in rows), "00.txt")


@pytest.mark.parametrize("variant", ["points", "planes"])
def test_a_trajectory_is_a_truth(tmp_path: Path, variant: Variant) -> None:
    write_tum(tmp_path / "a.tum", np.arange(20) / 4, POSES)
    truth = read_truth(tmp_path / "a.tum", variant)
    assert truth.stamps_s.tolist() == (np.arange(20) / 4).tolist()
    assert_allclose(truth.poses, POSES, atol=1e-12)
    assert not len(truth.landmark_ids)
    truth = read_truth(kitti(tmp_path), variant)
    assert truth.stamps_s.tolist() == list(range(20))
    assert_allclose(truth.poses, POSES, atol=1e-12)
    put(tmp_path, "".join(f"{0.1 * k}\n" for k in range(20)), "times.txt")
    assert_allclose(read_truth(tmp_path / "00.txt", variant).stamps_s, 0.1 * np.arange(20))


@pytest.mark.parametrize(
    ("content", "times", "problem"),
    [
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0\n", None, "line 2: '1 0 0 0', expected 12 numbers"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", None, "a.txt: pose 0 has no rotation"),
        ("1 0 0 0 0 .9 0 0 0 0 1 0\n", None, "a.txt: pose 0 has no rotation"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "1\n2\n", "times.txt: 2 times, expected 1 as in a.txt"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "one\n", "times.txt: line 1: 'one', expected one number"),
        ("1 0 0 0 0 0 0 1\n1 x\n", None, "line 2: '1 x', expected 8 numbers"),
    ],
)
def test_damaged_trajectories(
    tmp_path: Path, content: str, times: str | None, problem: str
) -> None:
    path = put(tmp_path, content, "a.txt")
    if times:
        put(tmp_path, times, "times.txt")
    with pytest.raises(RelmapError) as caught:
        read_truth(path)
    assert problem in str(caught.value)


def test_evaluate_takes_a_trajectory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "figure-eight", "-o", "eight", "--iterations", "40"]) == 0
    assert main(["map", "eight", "-o", "out", "--association", "known"]) == 0
    figures = []
    for truth in ("eight", "eight/truth/trajectory.tum"):
        assert main(["evaluate", "out", "--truth", truth]) == 0
        figures.append(load(tmp_path / "out" / "evaluation.json"))
    assert figures[0]["ate_m"] == pytest.approx(figures[1]["ate_m"], rel=1e-6)
    assert figures[0]["rpe_m"] == pytest.approx(figures[1]["rpe_m"], rel=1e-6)
    assert figures[1]["landmark_rmse_m"] is None
    assert "no RPE" not in capsys.readouterr().out
    stamps_s, poses = read_tum(Path("eight/truth/trajectory.tum"))
    between_s = np.sort(np.append(stamps_s, stamps_s + 0.5))
    write_tum(Path("fine.tum"), between_s, np.repeat(poses, 2, axis=0))
    assert main(["evaluate", "out", "--truth", "fine.tum"]) == 0
    said = "no RPE: 40 of 40 poses have the times of true ones, and other true poses lie between"
    assert said in capsys.readouterr().out


@pytest.mark.usefixtures("in_process")
def test_compare_takes_a_trajectory_for_walls(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    world = ["simulate", "building", "-o", "drive", "--beams", "181", "--iterations", "12"]
    assert main(world) == 0
    run = ["compare", "drive", "--methods", "relmap-planes", "-o"]
    assert main([*run, "whole"]) == 0
    assert main([*run, "path", "--truth", "drive/truth/trajectory.tum"]) == 0
    (whole,), (path,) = (table(Path(name, "comparison.csv")) for name in ("whole", "path"))
    for name in ("ate_m", "rpe_m"):
        assert float(path[name]) == pytest.approx(float(whole[name]), rel=1e-6)
    assert not path["corner_rmse_m"]


def test_a_log_that_is_its_own_truth_warns_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    put(tmp_path, CORRECTED.replace("5.5 host", "3.5 host"), "a.log")
    run = ["compare", "a.log", "--truth", "./a.log", "--methods", "relmap-planes", "-o", "out"]
    assert main(run) == 0
    assert caplog.messages == ["a.log: 1 scans out of order: all are sorted by time"]
