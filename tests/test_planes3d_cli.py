"""``relmap map --variant planes3d``, ``relmap simulate storey`` and ``relmap evaluate``."""

from __future__ import annotations

import json
import re
import shutil
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest

from relmap.cli import main
from relmap.datasets import open_scans
from relmap.datasets.trajectories import read_trajectory
from relmap.io.files import read_tum
from relmap.planes3d.files import COLUMNS
from tests.commands import RESULT_FILES, load, names, run_relmap, table

pytestmark = pytest.mark.usefixtures("unrendered")

FILES = sorted([*RESULT_FILES, "planes.csv"])


@pytest.fixture(scope="module")
def storey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lidar carried through a storey, and its map."""
    folder = tmp_path_factory.mktemp("storey")
    run_relmap("simulate", "storey", "-o", folder / "world", "--iterations", "10")
    run_relmap("map", folder / "world", "-o", folder / "result", "--variant", "planes3d")
    return folder


def test_result_folder_is_complete(storey: Path) -> None:
    result = storey / "result"
    assert names(result) == FILES
    rows = table(result / "planes.csv")
    assert list(rows[0]) == list(COLUMNS)
    static = [row for row in rows if row["status"] == "static"]
    assert len(static) >= 8
    for row in static:
        normal = np.array([float(row[name]) for name in ("nx", "ny", "nz")])
        corners = np.array([corner.split() for corner in row["outline"].split(";")], dtype=float)
        assert np.linalg.norm(normal) == pytest.approx(1)
        assert np.abs(corners @ normal - float(row["offset"])).max() < 1e-3
        assert 0 < float(row["sd_normal"]) < 0.01
        assert 0 < float(row["sd_centre"]) < 0.01
    summary = load(result / "summary.json")
    assert summary["variant"] == "planes3d"
    for status in ("static", "dynamic", "unmapped"):
        n_alike = sum(row["status"] == status for row in rows)
        assert summary["counts"][f"planes_{status}"] == n_alike
    assert summary["counts"]["iterations_without_pose"] == 0
    assert [part["scans"] for part in summary["submaps"]] == [10]
    assert summary["weak_links"] == []


def test_clouds_in_millimetres_are_doubted(
    storey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(storey / "world" / "scans.npz") as log:
        arrays = dict(log)
    arrays.pop("range_m", None)
    for scale in (1, 1000):
        np.savez(tmp_path / "scans.npz", **arrays | {"points": scale * arrays["points"]})
        made = ["-o", tmp_path / "map", "--variant", "planes3d", "--scans", "0:2"]
        run_relmap("map", tmp_path / "scans.npz", *made)
        assert ("coordinates must be in metres" in capsys.readouterr().err) == (scale == 1000)


def test_a_broken_run_says_so_with_advice(
    storey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scans = np.load(storey / "world" / "scans.npz")
    points, iteration, stamps_s = (scans[k] for k in ("points", "iteration", "stamps_s"))
    kept = iteration < 8
    np.savez(  # and on into a larger storey
        tmp_path / "both.npz",
        points=np.concatenate([points, 1.6 * points[kept]]),
        iteration=np.concatenate([iteration, iteration[kept] + 10]),
        stamps_s=np.concatenate([stamps_s, stamps_s[:8] + stamps_s[-1] + 1]),
    )
    capsys.readouterr()
    run_relmap("map", tmp_path / "both.npz", "-o", tmp_path / "map", "--variant", "planes3d")
    summary = load(tmp_path / "map" / "summary.json")
    assert [part["scans"] for part in summary["submaps"]] == [10, 8]
    planes = table(tmp_path / "map" / "planes.csv")
    centres = {row["plane"]: row["x"] for row in planes if row["submap"] == "1"}
    other = table(tmp_path / "map" / "submaps.csv")
    assert len(other) >= 8
    assert {row["submap"] for row in other} == {"1"}
    for row in other:
        assert float(row["x"]) == pytest.approx(float(centres[row["landmark"]]), abs=1e-3)
    _, poses = read_tum(tmp_path / "map" / "trajectory.tum")
    way = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert summary["submaps"][0]["metres"] == pytest.approx(way.sum())
    assert 0 < summary["steps"]["median_m"] <= way.max()
    said = capsys.readouterr().out
    assert "broke into 2 submaps" in said
    assert f"shorter steps (here {summary['steps']['median_m']:.2f} m" in said
    assert "odometry" not in said


def test_a_single_scan_says_that_a_map_needs_two(
    storey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = ["-o", tmp_path / "map", "--variant", "planes3d", "--scans", "0:1"]
    run_relmap("map", storey / "world", *made)
    assert "nothing is mapped: a map needs planes that at least two" in capsys.readouterr().out


def test_mesh_holds_polygons_on_the_planes(storey: Path) -> None:
    lines = (storey / "result" / "map.ply").read_text().splitlines()
    begin = lines.index("end_header") + 1
    points = int(next(line for line in lines if line.startswith("element vertex")).split()[2])
    faces = [np.array(line.split(), dtype=np.int64) for line in lines[begin + points :]]
    assert len(faces) > 20
    assert all(len(face) == 1 + face[0] >= 4 for face in faces)
    vertices = np.array([line.split()[:3] for line in lines[begin : begin + points]], dtype=float)
    assert np.array_equal(np.concatenate([face[1:] for face in faces]), np.arange(points))
    planes = [row for row in table(storey / "result" / "planes.csv") if row["status"] == "static"]
    normal = np.array([[float(row[name]) for name in ("nx", "ny", "nz")] for row in planes])
    off_m = np.abs(vertices @ normal.T - [float(row["offset"]) for row in planes])
    for face in faces:
        assert off_m[face[1:]].max(axis=0).min() < 1e-4


def test_report_shows_the_edges_of_the_planes(storey: Path) -> None:
    page = (storey / "result" / "report.html").read_text()
    (data,) = re.findall(r'<script id="data" type="application/json">(.*?)</script>', page)
    (view,) = json.loads(data)
    ends = np.frombuffer(b64decode(view["lines"]), "<f4").reshape(-1, 2, 3)
    planes = [row for row in table(storey / "result" / "planes.csv") if row["status"] == "static"]
    assert len(ends) == sum(len(row["outline"].split(";")) for row in planes)
    flat = np.abs(np.ptp(ends[:, :, 2], axis=1)) < 1e-3
    assert 0.2 < flat.mean() < 1  # the floor is level
    assert view["axes"] == 3
    assert view["caption"] == f"10 scans, {len(planes)} planes"
    assert len(b64decode(view["path"])) == 10 * 3 * 4


def test_outlines_name_the_planes_that_they_meet(storey: Path) -> None:
    rows = {row["plane"]: row for row in table(storey / "result" / "planes.csv")}
    met = 0
    for row in rows.values():
        corners = np.array([corner.split() for corner in row["outline"].split(";")], dtype=float)
        meets = row["meets"].split(";")
        assert len(meets) == len(corners)
        for begin, end, name in zip(corners, np.roll(corners, -1, axis=0), meets, strict=True):
            if name not in ("-1", "-2"):
                normal = np.array([float(rows[name][axis]) for axis in ("nx", "ny", "nz")])
                off_m = np.stack([begin, end]) @ normal - float(rows[name]["offset"])
                assert np.abs(off_m).max() < 1e-3
                met += 1
    assert met > 20


def test_path_is_that_of_the_truth(storey: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_relmap("evaluate", storey / "result", "--truth", storey / "world")
    evaluation = load(storey / "result" / "evaluation.json")
    (storey / "result" / "evaluation.json").unlink()
    assert evaluation["ate_m"] < 0.003
    assert evaluation["counts"] == {"poses": 10}
    figures = {"plane_recall", "plane_precision", "plane_rmse_m", "doubled_area"}
    unknown = {"coverage", "landmarks_per_true", "purity"}
    assert set(evaluation) == {"ate_m", "rpe_m", "counts", "notes"} | figures | unknown
    assert {evaluation[name] for name in unknown} == {None}
    assert evaluation["plane_precision"] == 1
    assert evaluation["plane_recall"] > 0.75
    assert evaluation["plane_rmse_m"] < 0.003
    assert evaluation["doubled_area"] < 0.02
    said = capsys.readouterr().out
    assert "plane recall" in said
    assert "coverage" not in said


@pytest.mark.parametrize("kitti", [False, True])
def test_the_truth_may_be_a_trajectory(storey: Path, tmp_path: Path, kitti: bool) -> None:
    stamps_s, poses = read_trajectory(storey / "world" / "truth" / "trajectory.tum")
    truth = tmp_path / "poses.txt"
    np.savetxt(truth, poses[:, :3].reshape(-1, 12))
    np.savetxt(tmp_path / "times.txt", stamps_s)
    truth = truth if kitti else storey / "world" / "truth" / "trajectory.tum"
    run_relmap("evaluate", storey / "result", "--truth", truth)
    evaluation = load(storey / "result" / "evaluation.json")
    (storey / "result" / "evaluation.json").unlink()
    assert evaluation["ate_m"] < 0.003
    assert evaluation["counts"] == {"poses": 10}


def test_planes_in_space_are_neither_exported_nor_merged(
    storey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result, out = str(storey / "result"), str(tmp_path / "out")
    for verb in (["export", result, "--to", "ply"], ["merge", result, result]):
        assert main([*verb, "-o", out]) == 2
        printed = capsys.readouterr().err
        assert f"{result} is a map of planes in space: only points and walls" in printed
        assert printed.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("in_process")
def test_compared_with_other_paths(storey: Path, tmp_path: Path) -> None:
    log, out = str(storey / "world"), tmp_path / "compared"
    run_relmap("compare", log, "-o", out, "--methods", "relmap-planes3d")
    (row,) = table(out / "comparison.csv")
    assert float(row["ate_m"]) < 0.003
    assert row["path_coverage"] == "1.0"
    whole = table(storey / "result" / "landmarks.csv")
    mapped = [each["landmark"] for each in whole if each["status"] == "static"]
    assert [each["landmark"] for each in table(out / "map-relmap-planes3d.csv")] == mapped
    assert (out / "map-relmap-planes3d.png").exists()


def test_walls_are_not_compared_in_clouds_with_floors(
    storey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["compare", str(storey / "world"), "-o", str(tmp_path / "no")]
    assert main([*asked, "--methods", "relmap-planes"]) == 2
    assert "clouds that show floors; these can: relmap-planes3d" in capsys.readouterr().err


def test_scans_and_voxel(storey: Path, tmp_path: Path) -> None:
    arguments = ["--variant", "planes3d", "--scans", "6:9", "--voxel", "0.3", "--no-refine"]
    run_relmap("map", storey / "world", "-o", tmp_path / "part", *arguments)
    summary = load(tmp_path / "part" / "summary.json")
    assert summary["configuration"]["voxel_m"] == 0.3
    assert summary["scans"] == [6, 9]
    assert read_tum(tmp_path / "part" / "trajectory.tum")[0].tolist() == [6, 7, 8]


@pytest.mark.parametrize(
    "arguments",
    [
        ["--variant", "planes3d", "--association", "known"],
        ["--variant", "planes3d", "--onto", "result"],
        ["--variant", "planes3d", "--config", "settings.toml"],
        ["--variant", "planes3d", "--animate"],
        ["--variant", "planes3d", "--voxel", "0"],
        ["--variant", "planes", "--voxel", "0.1"],
    ],
)
def test_options_of_other_variants_are_refused(
    storey: Path, tmp_path: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["map", str(storey / "world"), "-o", str(tmp_path / "no"), *arguments]) == 2
    assert "planes3d" in capsys.readouterr().err or "--voxel" in arguments
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    ("name", "scans", "limit_m"),
    [("lidar3d-hall", "0:8", 0.03), ("rgbd-7scenes-redkitchen", "0:12", 0.03)],
)
def test_real_clouds(
    shared_data: Path, tmp_path: Path, name: str, scans: str, limit_m: float
) -> None:
    if not (shared_data / name).is_dir():
        pytest.skip(f"{name} is not there")
    out = tmp_path / "result"
    run_relmap("map", shared_data / name, "-o", out, "--variant", "planes3d", "--scans", scans)
    run_relmap("evaluate", out, "--truth", shared_data / name)
    evaluation = load(out / "evaluation.json")
    assert evaluation["counts"]["poses"] == len(
        open_scans(shared_data / name).between(*map(int, scans.split(":")))
    )
    assert evaluation["ate_m"] < limit_m


def test_a_damaged_outline_is_named(
    storey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(storey / "result", tmp_path / "result")
    planes = tmp_path / "result" / "planes.csv"
    planes.write_text(planes.read_text().replace(";", ";x ", 1))
    arguments = ["evaluate", tmp_path / "result", "--truth", storey / "world"]
    assert main([str(argument) for argument in arguments]) == 2
    assert "field outline" in capsys.readouterr().err
