"""``relmap map --variant planes3d`` on scans without planes: what it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap.cli import main
from relmap.datasets import write_scans_npz
from relmap.evaluation.summary import steps_of
from tests.commands import RESULT_FILES, names, run_relmap

pytestmark = pytest.mark.usefixtures("unrendered")


def test_scans_of_the_ground_alone_say_what_they_lack(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    clouds = [np.append(rng.uniform(-9, 9, (2000, 2)), np.full((2000, 1), -1.2), 1)] * 6
    write_scans_npz(tmp_path / "scans.npz", clouds, np.arange(6.0))
    run_relmap("map", tmp_path, "-o", tmp_path / "map", "--variant", "planes3d")
    said = capsys.readouterr().out
    assert "0 planes mapped in 6 iterations" in said
    assert "no two scans could be connected: they must show planes of three directions" in said
    assert "1 scans" not in said


def test_undetermined_steps_do_not_count_as_usual_ones() -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = [0.0, 0.3, 145.3, 290.3, 435.3]
    path = [(poses, np.arange(7, 12))]
    assert steps_of(path, np.array([9, 10, 11]))["median_m"] == pytest.approx(0.3)
    assert steps_of(path, np.arange(8, 12))["median_m"] is None


def test_a_planar_log_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = ["--sampling", "laser", "--points", "181", "--iterations", "3"]
    run_relmap("simulate", "building", "-o", tmp_path / "world", *world)
    arguments = ["map", tmp_path / "world", "-o", tmp_path / "no", "--variant", "planes3d"]
    arguments += ["--journal", tmp_path / "run.journal"]
    assert main([str(argument) for argument in arguments]) == 2
    assert "2-D laser" in capsys.readouterr().err
    assert names(tmp_path) == ["world"]


def test_clouds_without_planes_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "clouds").mkdir()
    points = np.random.default_rng(2).uniform(-3, 3, (500, 4)).astype("<f4")
    points[:, 3] = np.abs(points[:, 3])  # the reflectance
    (tmp_path / "clouds" / "0.bin").write_bytes(points.tobytes())
    arguments = ["--variant", "planes3d", "--format", "kitti-bin"]
    run_relmap("map", tmp_path / "clouds", "-o", tmp_path / "result", *arguments)
    assert "no plane was found" in capsys.readouterr().out
    assert names(tmp_path / "result") == sorted([*RESULT_FILES, "planes.csv"])
