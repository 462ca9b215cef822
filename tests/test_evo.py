"""evo, an independent program (GPL: run as a tool, never imported), reads our files and agrees."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap.cli import main
from relmap.evaluation import metrics
from relmap.io.files import read_tum, write_tum
from tests.commands import load, run_process

APE, RPE = shutil.which("evo_ape"), shutil.which("evo_rpe")
pytestmark = pytest.mark.skipif(
    APE is None or RPE is None, reason="no evo: evo_ape is not on the PATH (pip install evo)"
)
CLOSE = 1e-6


def evo(program: str | None, folder: Path, truth: Path, found: Path, *more: str) -> float:
    """Return the RMSE that evo finds between two TUM files."""
    result = folder / "evo.zip"
    result.unlink(missing_ok=True)
    done = run_process(
        [str(program), "tum", str(truth), str(found), *more, "--save_results", str(result)],
        env=os.environ | {"HOME": str(folder), "MPLBACKEND": "Agg"},
        cwd=folder,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    with zipfile.ZipFile(result) as archive:
        return float(json.loads(archive.read("stats.json"))["rmse"])


def test_agrees_on_an_unmodified_result(tmp_path: Path) -> None:
    """Files of `relmap simulate` and `relmap map`, figures of `relmap evaluate`."""
    eight, out = str(tmp_path / "eight"), str(tmp_path / "out")
    assert main(["simulate", "figure-eight", "--iterations", "80", "-o", eight]) == 0
    assert main(["map", f"{eight}/observations.csv", "-o", out]) == 0
    assert main(["evaluate", out, "--truth", eight]) == 0
    figures = load(tmp_path / "out" / "evaluation.json")
    truth = tmp_path / "eight" / "truth" / "trajectory.tum"
    found = tmp_path / "out" / "trajectory.tum"
    assert evo(APE, tmp_path, truth, found, "--align") == pytest.approx(figures["ate_m"], abs=CLOSE)
    assert evo(RPE, tmp_path, truth, found) == pytest.approx(figures["rpe_m"], abs=CLOSE)


def test_agrees_where_paths_are_wild_and_stamps_differ(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    truth, found = (np.tile(np.eye(4), (60, 1, 1)) for _ in range(2))
    truth[:, :3, 3] = rng.normal(0, 3, (60, 3)).cumsum(axis=0)
    truth[:, :3, :3] = Rotation.random(60, rng).as_matrix()
    found[:, :3, 3] = truth[:, :3, 3] @ Rotation.random(None, rng).as_matrix() + [5, 6, 7]
    found[:, :3, 3] += rng.normal(0, 0.5, (60, 3))
    found[:, :3, :3] = Rotation.random(60, rng).as_matrix()
    stamps_s = 1.6e9 + np.arange(60, dtype=np.float64) / 10
    write_tum(tmp_path / "truth.tum", stamps_s, truth)
    write_tum(tmp_path / "found.tum", stamps_s + 0.004 * np.sin(np.arange(60.0)), found)
    mine, other = metrics.match_stamps(read_tum(tmp_path / "found.tum")[0], stamps_s)
    assert len(mine) == 60
    ate = metrics.ate(found[mine], truth[other], planar=False)
    rpe = metrics.rpe(found[mine], truth[other], other)
    files = tmp_path / "truth.tum", tmp_path / "found.tum"
    assert evo(APE, tmp_path, *files, "--align") == pytest.approx(ate, abs=CLOSE)
    assert evo(RPE, tmp_path, *files) == pytest.approx(rpe, abs=CLOSE)
