"""``relmap map --variant planes`` and ``relmap evaluate``, from scans to figures."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relmap.cli.outcome import broken, torn
from relmap.datasets import write_scans_npz
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
    assert "metres" not in printed
    assert "could not be refined" not in printed


def test_a_log_of_a_wall_and_a_pole_says_what_is_true(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Steps along the wall are undetermined, and the submap cannot be refined."""
    rng = np.random.default_rng(0)
    bearings, scans = np.linspace(-np.pi / 2, np.pi / 2, 181), []
    for x in np.linspace(-3.0, 3.0, 30):
        ahead = np.column_stack([np.cos(bearings + 0.15 * x), np.sin(bearings + 0.15 * x)])
        beside = ahead @ [1 - x, 1.0]
        with np.errstate(invalid="ignore"):
            pole_m = beside - np.sqrt(beside**2 - np.hypot(1 - x, 1.0) ** 2 + 0.3**2)
        wall_m = 3 / np.maximum(ahead[:, 1], 1e-9)
        range_m = np.fmin(wall_m, np.where(beside > 0, pole_m, np.nan)) + rng.normal(0, 0.01, 181)
        seen = range_m < 8
        scans.append((range_m[seen] * [np.cos(bearings[seen]), np.sin(bearings[seen])]).T)
    write_scans_npz(tmp_path / "scans.npz", scans, np.arange(30.0))
    run_relmap("map", tmp_path, "-o", tmp_path / "out", "--variant", "planes")
    summary = load(tmp_path / "out" / "summary.json")
    assert summary["counts"]["planes_static"] == 0 < len(summary["weak_links"])
    assert capsys.readouterr().out.endswith(
        "; nothing is mapped; the only submap could not be refined; steps that the scans do not "
        f"determine, and that may be wrong: {len(summary['weak_links'])}\n"
    )
    assert [submap["refined"] for submap in summary["submaps"]] == [summary["refined"]] == [False]


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
    printed = capsys.readouterr().err
    assert re.search(
        r"the points of the first scan are \S+ m away in the median: .* metres", printed
    )


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
    assert ate_m(run.result.poses[mine], log.poses[other]) <= 0.08


def closing(*submaps: tuple[int, bool], walls: int = 9, apart: int = 0) -> str:
    """Return the end of the message about submaps, given their scans and whether refined.

    `apart`: number of scans that are in none.
    """
    steps = {"median_m": None, "median_deg": None, "view_deg": None}
    rows, end = [], 0
    for n, refined in submaps:
        at = [end, end + n - 1]
        rows.append({"scans": n, "refined": refined, "metres": 1.0, "iterations": at})
        end += n
    about = {"submaps": rows, "weak_links": [], "steps": steps, "variant": "planes"}
    counts = {"planes_static": walls, "iterations": end + apart}
    return torn(about | {"counts": counts}, refine=True)


def test_scans_without_walls_are_counted() -> None:
    assert closing((35, True)) == ""
    assert closing((35, True), apart=69) == (
        "; scans that show hardly any walls, and have no pose: 69"
    )


def test_scans_in_the_midst_that_fit_nowhere_are_named_and_no_break() -> None:
    rows = [
        {"scans": n, "refined": True, "metres": 1.0, "iterations": at}
        for n, at in ((60, [0, 62]), (2, [20, 21]), (1, [30, 30]))
    ]
    summary = {"submaps": rows, "counts": {"planes_static": 9}}
    said = "; scans that fit nowhere, and are not in the map: 3 (iterations 20-21, 30)"
    assert broken(summary) == said
    rows[1]["iterations"] = [63, 64]  # after the last of the others
    assert "broke into 3 submaps" in broken(summary)


@pytest.mark.parametrize(("scans", "failed"), [(3, ""), (4, "1 of 2 submaps of four scans")])
def test_submaps_too_small_for_a_wall_are_not_said_to_fail(scans: int, failed: str) -> None:
    message = closing((90, True), (scans, False))
    assert ("could not be refined" in message) == bool(failed)
    assert failed in message


def test_an_empty_map_does_not_hide_its_submaps() -> None:
    assert closing((90, False), walls=0) == (
        "; nothing is mapped; the only submap could not be refined"
    )
    message = closing((1, False), (1, False), walls=0)
    assert "the run broke into 2 submaps, the largest of 1 scan and 1.0 m. More overlap" in message
    assert closing((90, True), walls=0).endswith("in at least four scans")
