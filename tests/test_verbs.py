"""Each verb on each kind of input and of truth that the help names, through the command line."""

from __future__ import annotations

import math
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from relmap.cli import main
from relmap.cli.simulate import Sampling, World
from relmap.datasets import FORMATS, SCAN_FORMATS, open_scans, write_observation_csv
from relmap.io.files import read_tum, write_tum
from relmap.io.results import read_result, write_result
from relmap.planes import PlaneMapper
from relmap.planes.walls.files import read_planes, write_planes
from relmap.simulation import simulate_figure_eight
from tests.commands import RESULT_FILES, load, names, table
from tests.everyformat import LASER_AHEAD_M, POINTS, WALLS, Mapped

pytestmark = pytest.mark.usefixtures("unrendered")

SAMPLING = {"glass": "laser"}
PATH, PLACES = ("ate_m", "rpe_m"), ("landmark_rmse_m", "coverage", "landmarks_per_true", "purity")
CORNERS = ("corner_rmse_m", "coverage")
PLAN = {"wall_recall", "wall_precision", "doubled_length"}
"""Metrics of walls only; the comparison, which has other methods too, leaves them out."""
RELATED = ("relation_m", "relation_rad")
TRUTHS = [
    ("csv/observations.csv", "csv", (*PLACES, *PATH)),
    ("gz", "gz/truth", (*PLACES, *PATH)),
    ("flat", "flat", (*PLACES, *PATH)),
    ("mrpt/a.observations.csv.gz", "mrpt/a_ground_truth.txt", (*PLACES, *PATH)),
    ("mrpt/a.observations.csv.gz", "mrpt", (*PLACES, *PATH)),
    ("park", "park", PLACES),
    ("circles", "circles", PLACES[1:]),
    ("beacons", "beacons", (*PLACES, *PATH)),
    ("npz", "npz", (*CORNERS, *PATH)),
    ("npz", "npz/truth", (*CORNERS, *PATH)),
    ("carmen/a.log.gz", "carmen/a.log.gz", PATH),
    ("graph/a.log", "graph/a.log", PATH),
    ("graph/a.log", "graph/a.relations", RELATED),
    ("laser/a.scans.csv.gz", "laser/a.scans.csv.gz", PATH),
    ("clouds", "clouds", PATH),
]
IN_SPACE = {"csv/observations.csv", "gz", "mrpt/a.observations.csv.gz"}
IN_SPACE |= {"table/seen.parquet", "detections/a.bag"}
DRAWN = ("circles", "npz", "graph/a.relations", "clouds")
MORE_OF_WALLS = ["bench.png", "planes.csv"]


WITH_ODOMETRY = "laser/a.scans.csv.gz"


def test_every_format_is_in_the_table() -> None:
    assert {name for name, _ in POINTS} == set(FORMATS)
    # Depth images show floors and tables: `test_planes3d_cli` maps them.
    assert {name for name, _ in WALLS} | {"depth-images", "tum-rgbd"} == set(SCAN_FORMATS)


@pytest.mark.parametrize(("form", "source"), [*POINTS, *WALLS])
def test_map(mapped: Mapped, form: str, source: str) -> None:
    folder, walls = mapped(source), form in SCAN_FORMATS
    assert names(folder) == sorted([*RESULT_FILES, *(MORE_OF_WALLS if walls else [])])
    summary = load(folder / "summary.json")
    assert (summary["format"], summary["variant"]) == (form, "planes" if walls else "points")
    counts = summary["counts"]
    assert counts["planes_static"] >= 3 if walls else counts["mapped"] == 12
    assert summary["dimensions"] == (3 if source in IN_SPACE else 2)


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize(("source", "truth", "figures"), TRUTHS)
def test_evaluate_and_compare(
    mapped: Mapped,
    logs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    source: str,
    truth: str,
    figures: tuple[str, ...],
) -> None:
    """Both take the same truth and find the same, for both map the log in the same way."""
    if truth not in DRAWN:
        monkeypatch.setattr("relmap.cli.compared.draw", lambda *_: None)
    folder = tmp_path / "map"
    if source == WITH_ODOMETRY:  # compare uses none
        mapping = ["map", str(logs / source), "-o", str(folder), "--variant", "planes"]
        assert main([*mapping, "--odometry", "none"]) == 0
    else:
        shutil.copytree(mapped(source), folder)  # `evaluate` writes into it
    against = ["--truth", str(logs / truth)]
    assert main(["evaluate", str(folder), *against]) == 0
    found = load(folder / "evaluation.json")
    told = {name for name, value in found.items() if isinstance(value, float)}
    assert ("doubled_length" in told) == (source in [name for _, name in WALLS])
    told -= PLAN
    assert told - {"landmarks_per_true"} == set(figures) - {"landmarks_per_true"}
    for name in figures:
        if name.endswith(("_m", "_rad")):
            assert found[name] < 0.06
    assert found["notes"] == []
    method = "relmap-planes" if source in [name for _, name in WALLS] else "relmap-points"
    run = ["compare", str(logs / source), *against, "--methods", method]
    assert main([*run, "--association", "nearest", "-o", str(tmp_path)]) == 0
    (row,) = table(tmp_path / "comparison.csv")
    for name in figures:
        assert float(row[name]) == pytest.approx(found[name], rel=1e-9, abs=1e-12)
    ours, theirs = (
        read_tum(path)
        for path in (folder / "trajectory.tum", tmp_path / f"trajectory-{method}.tum")
    )
    np.testing.assert_array_equal(ours[0], theirs[0])
    np.testing.assert_allclose(ours[1], theirs[1], atol=1e-9)


def test_compare_uses_the_pose_of_the_laser(logs: Path) -> None:
    """The case above is one in which it matters."""
    view = open_scans(logs / "laser").sensor
    assert view.x_m == LASER_AHEAD_M
    assert view.view_rad == pytest.approx(math.pi)
    assert view.range_m == 8.0


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize("source", ["circles", "carmen/a.log.gz"])
def test_compare_without_truth(
    logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], source: str
) -> None:
    out = tmp_path / "out"
    method = "relmap-planes" if source in [name for _, name in WALLS] else "relmap-points"
    run = ["compare", str(logs / source), "--methods", method, "--association", "nearest"]
    assert main([*run, "-o", str(out)]) == 0
    assert capsys.readouterr().out.endswith(
        f"wrote comparison.csv, 1 trajectory and map and 2 pictures to {out}\n"
    )
    (row,) = table(out / "comparison.csv")
    assert row["ate_m"] == row["landmark_rmse_m"] == row["relation_m"] == ""
    assert len(read_tum(out / f"trajectory-{method}.tum")[0]) >= 15


def test_a_map_that_is_too_wrong_gets_figures_and_a_word(
    mapped: Mapped, logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "far"
    shutil.copytree(mapped("npz"), folder)
    walls = read_planes(folder)
    write_planes(folder, replace(walls, ends=walls.ends + 50.0))
    assert main(["evaluate", str(folder), "--truth", str(logs / "npz")]) == 0
    found = load(folder / "evaluation.json")
    assert (found["corner_rmse_m"], found["landmarks_per_true"]) == (None, None)
    assert found["coverage"] == found["counts"]["matched_corners"] == 0
    assert found["counts"]["false_corners"] > 2
    assert found["ate_m"] < 0.05
    printed = capsys.readouterr().out
    assert "no corner RMSE: the map is too far off" in printed
    assert f"{found['counts']['false_corners']} of {found['counts']['false_corners']}" in printed


@pytest.mark.parametrize("n_scans", [3, 4])
def test_a_map_of_too_few_scans_says_what_is_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], n_scans: int
) -> None:
    points = np.array([[1.0, 2.0], [3.0, 1.0], [2.0, 4.0], [5.0, 5.0]])
    rows = [f"{k},{x + 0.1 * k},{y}" for k in range(n_scans) for x, y in points.tolist()]
    log = tmp_path / "observations.csv"
    log.write_text("\n".join(["iteration,x,y", *rows]) + "\n", encoding="utf-8")
    assert main(["map", str(log), "-o", str(tmp_path / "result")]) == 0
    printed = capsys.readouterr().out
    assert ("nothing is mapped: a map needs landmarks" in printed) == (n_scans == 3)
    assert ("three in the plane and four in space" in printed) == (n_scans == 3)
    assert ("4 of 4 landmarks mapped" in printed) == (n_scans == 4)


def test_points_that_are_repeated_in_a_scan_count_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = np.array([[1.0, 2.0], [3.0, 1.0], [2.0, 4.0], [5.0, 5.0]])
    rows = [f"{k},{x + 0.1 * k},{y}" for k in range(5) for x, y in points.tolist()]
    log = tmp_path / "observations.csv"
    log.write_text("\n".join(["iteration,x,y", *rows, *rows]) + "\n", encoding="utf-8")
    assert main(["map", str(log), "-o", str(tmp_path / "result")]) == 0
    printed = capsys.readouterr()
    assert "20 points left out that repeat another one of their scan exactly" in printed.err
    assert "4 of 4 landmarks mapped from 20 observations" in printed.out


def test_the_closing_line_counts_landmarks_seen_often(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "observations.csv"
    write_observation_csv(log, simulate_figure_eight(iterations=60).log)
    assert main(["map", str(log), "-o", str(tmp_path / "result")]) == 0
    found = read_result(tmp_path / "result").landmarks
    often, mapped = found.observations >= 10, found.status == "static"
    assert 0 < often.sum() < len(found)
    said = (
        f"{mapped.sum()} of {len(found)} landmarks ({(often & mapped).sum()} of {often.sum()} seen"
    )
    assert f"{said} 10 times or more) mapped" in capsys.readouterr().out


def test_a_path_without_common_times_is_reported(
    mapped: Mapped, logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for source, truth in (("npz", "npz"), ("csv/observations.csv", "csv")):
        folder = tmp_path / truth
        shutil.copytree(mapped(source), folder)
        stamps_s, poses = read_tum(folder / "trajectory.tum")
        write_tum(folder / "trajectory.tum", stamps_s + 0.07, poses)
        assert main(["evaluate", str(folder), "--truth", str(logs / truth)]) == 0
        assert load(folder / "evaluation.json")["ate_m"] is None
        out = capsys.readouterr().out
        assert "no pose of the result has the time of a true one (" in out
        first, last = f"{stamps_s.min() + 0.07:.10g}", f"{stamps_s.max() + 0.07:.10g}"
        assert f"({first} to {last} s, true: " in out
    assert main(["evaluate", str(tmp_path / "npz"), "--truth", str(logs / "graph/a.log")]) == 0


@pytest.mark.parametrize(("source", "truth"), [("npz", "npz"), ("csv/observations.csv", "csv")])
def test_what_drifted_beyond_all_sensors_is_read_and_evaluated(
    mapped: Mapped, logs: Path, tmp_path: Path, source: str, truth: str
) -> None:
    result = read_result(mapped(source))
    poses = result.poses.copy()
    poses[:, :3, 3] *= 1e40
    landmarks = replace(result.landmarks, position=result.landmarks.position * 1e40)
    write_result(tmp_path, replace(result, poses=poses, landmarks=landmarks))
    if source == "npz":
        walls = read_planes(mapped(source))
        write_planes(tmp_path, replace(walls, ends=walls.ends * 1e40))
    assert main(["evaluate", str(tmp_path), "--truth", str(logs / truth)]) == 0
    assert load(tmp_path / "evaluation.json")["ate_m"] > 1e30


@pytest.mark.parametrize(
    "options",
    [
        ["figure-eight", "--noise", "uniform", "--density", "10"],
        ["figure-eight", "--dynamic", "0.4", "--seed", "3"],
        *(
            ["building", "--world", world, "--sampling", SAMPLING.get(world, "surface")]
            for world in get_args(World)
        ),
        *(["building", "--sampling", sampling] for sampling in get_args(Sampling)),
        ["building", "--moving", "2"],
        ["building", "--world", "panels", "--moving", "2", "--sampling", "laser"],
        ["building", "--noise", "uniform", "--loops", "2"],
    ],
    ids=" ".join,
)
def test_simulate_then_map_then_evaluate(tmp_path: Path, options: list[str]) -> None:
    world, result = tmp_path / "world", tmp_path / "result"
    building = options[0] == "building"
    more = ["--points", "150", "--sigma", "0.01"] if building else []
    assert main(["simulate", *options, *more, "--iterations", "6", "-o", str(world)]) == 0
    variant = ["--variant", "planes"] if building else []
    assert main(["map", str(world), "-o", str(result), *variant]) == 0
    assert main(["evaluate", str(result), "--truth", str(world)]) == 0
    found = load(result / "evaluation.json")
    assert found["ate_m"] is not None or found["notes"]


def test_walls_are_resumed_where_they_were_interrupted(
    logs: Path,
    mapped: Mapped,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    update, out, journal = PlaneMapper.update, tmp_path / "out", tmp_path / "run.journal"

    def interrupted(self: PlaneMapper, *scan: Any, **more: Any) -> Any:
        if self.n_iterations == 9:
            os.kill(os.getpid(), signal.SIGINT)
        return update(self, *scan, **more)

    run = ["map", str(logs / "npz"), "--variant", "planes", "--journal", str(journal)]
    with monkeypatch.context() as patch:
        patch.setattr(PlaneMapper, "update", interrupted)
        assert main([*run, "-o", str(out)]) == 130
    assert load(out / "summary.json")["counts"]["iterations"] == 10
    for _ in range(2):
        assert main(["resume", str(journal)]) == 0
        for name in ("planes.csv", "landmarks.csv", "tracks.csv.gz", "trajectory.tum"):
            assert (out / name).read_bytes() == (mapped("npz") / name).read_bytes()
    assert "none of them new" in capsys.readouterr().out
