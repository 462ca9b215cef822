"""``relmap map --variant planes`` and ``relmap evaluate``, from scans to figures."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relmap.cli.outcome import torn
from relmap.datasets.scans import ScanLog
from relmap.evaluation import metrics
from relmap.evaluation.run import run_mapper
from relmap.planes import PlaneMapper
from relmap.planes.walls.files import read_planes
from relmap.segmentation import PlaneSegmenter
from tests.commands import load, run_relmap, table
from tests.worlds import ate_m

pytestmark = pytest.mark.usefixtures("unrendered")

CONTRACT = (
    "plane,x0,y0,x1,y1,z0,z1,nx,ny,nz,end0,end1,observations,first_iteration,last_iteration,status"
)


@pytest.fixture(scope="module")
def building(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A noisy laser's drive through a part of a building, and its map."""
    folder = tmp_path_factory.mktemp("building")
    world = ["--sampling", "laser", "--points", "361", "--sigma", "0.01", "--iterations", "80"]
    run_relmap("simulate", "building", "-o", folder / "world", *world)
    run_relmap("map", folder / "world", "-o", folder / "result", "--variant", "planes")
    return folder


def test_result_folder_is_complete(building: Path) -> None:
    with (building / "result" / "planes.csv").open() as stream:
        header = next(csv.reader(stream))
    assert header[:16] == CONTRACT.split(",")
    status = read_planes(building / "result").status
    assert set(status.tolist()) <= {"static", "dynamic", "unmapped"}
    assert (status == "static").sum() >= 5
    summary = load(building / "result" / "summary.json")
    assert summary["variant"] == "planes"
    assert summary["counts"]["iterations"] == 80
    names = ("landmarks.csv", "tracks.csv.gz", "trajectory.tum", "map.ply", "map.png")
    assert all((building / "result" / name).stat().st_size > 0 for name in names)


def test_an_empty_map_says_what_is_needed(
    building: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = ["--variant", "planes", "--scans", "0:2"]
    run_relmap("map", building / "world", "-o", tmp_path / "result", *few)
    printed = capsys.readouterr().out
    assert "nothing is mapped: a map needs walls that are seen in at least four scans" in printed
    assert re.search(r"metres: here the farthest point is [78]\.\d* m away\n", printed)
    assert "could not be refined" not in printed


def map_scaled(building: Path, folder: Path, scale: float) -> None:
    """Map the first scans of the building at another scale."""
    with np.load(building / "world" / "scans.npz") as log:
        arrays = dict(log)
    arrays |= {name: scale * arrays[name] for name in ("points", "range_m")}
    np.savez(folder / "scans.npz", **arrays)
    log = ["--variant", "planes", "--scans", "0:20"]
    run_relmap("map", folder / "scans.npz", "-o", folder / "result", *log)


def test_a_model_whose_walls_do_not_last_is_an_empty_map(
    building: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    map_scaled(building, tmp_path, 0.05)
    assert "nothing is mapped" in capsys.readouterr().out
    refinement = load(tmp_path / "result" / "summary.json")["refinement"]
    assert refinement["segments"] == 0
    assert refinement["segment_residual_median"] is None


@pytest.mark.parametrize("scale", [100, 1000])
def test_a_log_in_other_units_is_reported(
    building: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], scale: int
) -> None:
    map_scaled(building, tmp_path, scale)
    printed = capsys.readouterr().out
    assert re.search(r"metres: here the farthest point is [78]\d\d+(\.\d+)? m away\n", printed)
    assert "shorter steps" not in printed


def test_figures_against_the_truth(building: Path) -> None:
    run_relmap("evaluate", building / "result", "--truth", building / "world")
    figures = load(building / "result" / "evaluation.json")
    assert figures["corner_rmse_m"] < 0.04
    assert figures["coverage"] >= 0.85
    assert figures["ate_m"] < 0.04


def test_one_submap_with_all_the_corners_that_are_mapped(building: Path) -> None:
    (submap,) = load(building / "result" / "summary.json")["submaps"]
    mapped = [row for row in table(building / "result" / "landmarks.csv") if row["x"]]
    assert submap["landmarks"] == len(mapped) > 5


def test_wrong_corners_are_reported(building: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_relmap("evaluate", building / "result", "--truth", building / "world")
    counts = load(building / "result" / "evaluation.json")["counts"]
    told = " ".join(capsys.readouterr().out.split())
    both = counts["false_corners"] + counts["matched_corners"]
    assert f"false corners {counts['false_corners']} of {both}" in told


def test_a_map_of_points_takes_away_what_only_walls_have(building: Path, tmp_path: Path) -> None:
    run_relmap("simulate", "figure-eight", "-o", tmp_path / "eight", "--iterations", 30)
    shutil.copytree(building / "result", tmp_path / "result")
    run_relmap("map", tmp_path / "eight" / "observations.csv", "-o", tmp_path / "result")
    left = {path.name for path in (tmp_path / "result").iterdir()}
    assert not left & {"planes.csv", "bench.png", "bench.gif", "evaluation.json"}


def test_first_metres_of_freiburg_079(real_scans: Callable[[str], ScanLog]) -> None:
    log = real_scans("carmen-laser2d/freiburg-079-corrected.log.gz").between(0, 150)
    run = run_mapper(PlaneMapper(), log, refine=True, segmenter=PlaneSegmenter())
    assert len(run.result.poses) >= 0.95 * len(log)
    mine, other = metrics.match_stamps(run.result.stamps_s, log.stamps_s)
    assert log.poses is not None
    assert ate_m(run.result.poses[mine], log.poses[other]) <= 0.08


@pytest.mark.parametrize(("scans", "failed"), [(3, ""), (4, "1 of 2 submaps of four scans")])
def test_submaps_too_small_for_a_wall_are_not_said_to_fail(scans: int, failed: str) -> None:
    sizes = {"metres": 1.0, "iterations": 1}
    submaps = [{"scans": 90, "refined": True, **sizes}, {"scans": scans, "refined": False, **sizes}]
    about = {"submaps": submaps, "refined": True, "weak_links": [], "steps": {"median_m": None}}
    message = torn(about, 8.0)
    assert ("could not be refined" in message) == bool(failed)
    assert failed in message
