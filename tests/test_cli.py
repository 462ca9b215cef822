"""The verbs of the command line, as the contract of files and columns has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap.cli import main
from relmap.evaluation.truth import read_truth
from relmap.io.files import read_tum
from tests.commands import RESULT_FILES, load, names, table

pytestmark = pytest.mark.usefixtures("unrendered")

LANDMARK_COLUMNS = [
    "landmark",
    "x",
    "y",
    "z",
    "sd",
    "observations",
    "first_iteration",
    "last_iteration",
    "level",
    "status",
    "submap",
    "moving_bin",
]
FIGURES = ["landmark_rmse_m", "coverage", "landmarks_per_true", "purity", "ate_m", "rpe_m"]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short simulated run."""
    folder = tmp_path_factory.mktemp("world") / "eight"
    options = ["--iterations", "60", "--density", "12", "--seed", "3"]
    assert main(["simulate", "figure-eight", "-o", str(folder), *options]) == 0
    return folder


@pytest.fixture(scope="module")
def result(world: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its map, with the association known."""
    folder = tmp_path_factory.mktemp("result") / "map"
    log = str(world / "observations.csv")
    assert main(["map", log, "-o", str(folder), "--association", "known"]) == 0
    return folder


def test_simulate_writes_log_and_truth(world: Path) -> None:
    assert names(world) == ["observations.csv", "truth"]
    assert names(world / "truth") == ["landmarks.csv", "trajectory.tum"]
    assert (world / "observations.csv").read_text().startswith("iteration,x,y,z,id\n")
    landmarks = table(world / "truth" / "landmarks.csv")
    assert list(landmarks[0]) == ["landmark", "x", "y", "z", "status"]
    assert {row["status"] for row in landmarks} == {"static"}
    stamps_s, _ = read_tum(world / "truth" / "trajectory.tum")
    assert stamps_s.tolist() == list(range(60))


def test_simulate_is_the_same_for_the_same_seed(world: Path, tmp_path: Path) -> None:
    options = ["simulate", "figure-eight", "--iterations", "60", "--density", "12"]
    for seed, same in (("3", True), ("4", False)):
        assert main([*options, "--seed", seed, "-o", str(tmp_path / seed)]) == 0
        for name in ("observations.csv", "truth/landmarks.csv"):
            again = (tmp_path / seed / name).read_bytes()
            assert (again == (world / name).read_bytes()) is same


def test_simulate_moves_landmarks(tmp_path: Path) -> None:
    options = ["--dynamic", "0.5", "--noise", "uniform", "--iterations", "10", "--density", "4"]
    assert main(["simulate", "figure-eight", "-o", str(tmp_path), *options]) == 0
    status = [row["status"] for row in table(tmp_path / "truth" / "landmarks.csv")]
    assert status.count("dynamic") == len(status) // 2


def test_map_writes_the_result_folder(world: Path, result: Path) -> None:
    assert names(result) == RESULT_FILES
    log, landmarks = table(world / "observations.csv"), table(result / "landmarks.csv")
    tracks = table(result / "tracks.csv.gz")
    assert list(landmarks[0]) == LANDMARK_COLUMNS
    assert list(tracks[0]) == ["iteration", "row", "landmark"]
    for track in tracks:
        row = log[int(track["row"])]
        assert (row["iteration"], row["id"]) == (track["iteration"], track["landmark"])
    for landmark in landmarks:
        seen = [row for row in log if row["id"] == landmark["landmark"]]
        assert int(landmark["observations"]) == len(seen)
        assert landmark["first_iteration"] == seen[0]["iteration"]
        assert landmark["last_iteration"] == seen[-1]["iteration"]
        mapped = landmark["status"] != "unmapped"
        assert mapped == (landmark["level"] != "0") == (landmark["x"] != "")


def test_summary(world: Path, result: Path) -> None:
    summary = load(result / "summary.json")
    landmarks = table(result / "landmarks.csv")
    assert summary["input"] == str(world / "observations.csv")
    assert summary["format"] == "observation-csv"
    assert (summary["variant"], summary["association"]) == ("points", "known")
    assert summary["scans"] == [0, 60]
    assert summary["seed"] is None
    assert "group_after" in summary["configuration"]
    assert set(summary["versions"]) == {"relmap", "python", "numpy", "scipy"}
    counts = summary["counts"]
    assert counts["iterations"] == 60
    assert counts["observations"] == len(table(world / "observations.csv"))
    assert counts["landmarks"] == len(landmarks)
    assert counts["mapped"] == sum(row["x"] != "" for row in landmarks)
    assert {*summary["timing"]} == {
        "median_ms",
        "p95_ms",
        "first_100_median_ms",
        "last_100_median_ms",
        "refine_ms",
        "reading_s",
        "mapping_s",
        "finish_s",
        "total_s",
    }
    assert all(value > 0 for value in summary["timing"].values())
    assert summary["timing"]["mapping_s"] >= 60e-3 * summary["timing"]["median_ms"] / 2
    stages_s = [summary["timing"][stage] for stage in ("reading_s", "mapping_s", "finish_s")]
    assert sum(stages_s) + summary["timing"]["refine_ms"] / 1e3 < summary["timing"]["total_s"]


def test_ply_holds_the_mapped_landmarks(result: Path) -> None:
    header, body = (result / "map.ply").read_text().split("end_header\n")
    mapped = [row for row in table(result / "landmarks.csv") if row["x"]]
    assert header.startswith("ply\nformat ascii 1.0\n")
    assert f"element vertex {len(mapped)}\n" in header
    assert body.splitlines() == [f"{row['x']} {row['y']} {row['z']}" for row in mapped]


def test_the_same_input_gives_the_same_bytes(world: Path, result: Path, tmp_path: Path) -> None:
    log = str(world / "observations.csv")
    assert main(["map", log, "-o", str(tmp_path), "--association", "known"]) == 0
    for name in RESULT_FILES:
        if name != "summary.json":
            assert (tmp_path / name).read_bytes() == (result / name).read_bytes(), name
    ours, theirs = (load(folder / "summary.json") for folder in (tmp_path, result))
    assert ours.pop("timing") is not None
    assert theirs.pop("timing") is not None
    assert ours == theirs


def test_the_truth_may_be_given_as_its_file(world: Path) -> None:
    by_file, by_folder = read_truth(world / "truth" / "landmarks.csv"), read_truth(world)
    assert np.array_equal(by_file.landmarks_map, by_folder.landmarks_map)
    assert np.array_equal(by_file.poses, by_folder.poses)


def test_scans_keep_the_numbers_of_the_log(world: Path, tmp_path: Path) -> None:
    assert main(["map", str(world), "-o", str(tmp_path), "--scans", "20:50"]) == 0
    iterations = [int(track["iteration"]) for track in table(tmp_path / "tracks.csv.gz")]
    assert (min(iterations), max(iterations)) == (20, 49)
    stamps_s, _ = read_tum(tmp_path / "trajectory.tum")
    assert set(stamps_s) <= set(range(20, 50))
    assert load(tmp_path / "summary.json")["scans"] == [20, 50]
    assert min(int(row["first_iteration"]) for row in table(tmp_path / "landmarks.csv")) == 20


def test_config_reaches_the_mapper(world: Path, tmp_path: Path) -> None:
    config = tmp_path / "mapper.toml"
    config.write_text("group_after = 3\n")
    assert main(["map", str(world), "-o", str(tmp_path / "out"), "--config", str(config)]) == 0
    assert load(tmp_path / "out" / "summary.json")["configuration"]["group_after"] == 3


def test_planar_log(tmp_path: Path) -> None:
    log = tmp_path / "observations.csv"
    trees = [(2.0, 0.0), (0.0, 2.0), (3.0, 3.0), (1.0, 4.0)]
    rows = [f"{k},{x - 0.1 * k!r},{y!r}" for k in range(20) for x, y in trees]
    log.write_text("iteration,x,y\n" + "\n".join(rows) + "\n")
    assert main(["map", str(log), "-o", str(tmp_path / "out")]) == 0
    assert {row["z"] for row in table(tmp_path / "out" / "landmarks.csv")} == {"0.0"}


def test_log_of_one_observation_gives_an_empty_map(tmp_path: Path) -> None:
    log = tmp_path / "observations.csv"
    log.write_text("iteration,x,y,z,id\n7,1,2,3,5\n")
    assert main(["map", str(log), "-o", str(tmp_path / "out"), "--association", "known"]) == 0
    (row,) = table(tmp_path / "out" / "landmarks.csv")
    assert ",".join(row.values()) == "5,,,,,1,7,7,0,unmapped,-1,-1"
    truth = tmp_path / "landmarks.csv"
    truth.write_text("landmark,x,y,z,status\n5,1,2,3,static\n")
    assert main(["evaluate", str(tmp_path / "out"), "--truth", str(tmp_path)]) == 0
    evaluation = load(tmp_path / "out" / "evaluation.json")
    assert evaluation["purity"] == 1
    assert evaluation["landmark_rmse_m"] is evaluation["ate_m"] is None


def test_evaluate(world: Path, result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(result), "--truth", str(world)]) == 0
    printed = capsys.readouterr()
    assert "landmark RMSE" in printed.out
    assert printed.err == ""
    evaluation = load(result / "evaluation.json")
    assert list(evaluation)[:6] == FIGURES
    assert evaluation["purity"] == evaluation["landmarks_per_true"] == 1
    assert 0 < evaluation["landmark_rmse_m"] < 1
    assert 0 < evaluation["coverage"] <= 1
    assert 0 < evaluation["ate_m"] < 1
    assert 0 < evaluation["rpe_m"] < 0.5
    (result / "evaluation.json").unlink()


def test_evaluate_finds_the_log(world: Path, tmp_path: Path) -> None:
    log, out = tmp_path / "log.csv", tmp_path / "out"
    log.write_bytes((world / "observations.csv").read_bytes())
    assert main(["map", str(log), "-o", str(out)]) == 0
    evaluations = []
    for arguments in ([], ["--log", str(world)], []):
        assert main(["evaluate", str(out), "--truth", str(world / "truth"), *arguments]) == 0
        evaluations.append(load(out / "evaluation.json"))
        log.unlink(missing_ok=True)  # from here on it is the one beside the truth
    assert evaluations[0] == evaluations[1] == evaluations[2]
    assert evaluations[0]["purity"] is not None


def test_without_a_log_some_figures_are_null(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out, truth = tmp_path / "log.csv", tmp_path / "out", tmp_path / "truth"
    log.write_bytes((world / "observations.csv").read_bytes())
    truth.mkdir()
    for name in ("landmarks.csv", "trajectory.tum"):
        (truth / name).write_bytes((world / "truth" / name).read_bytes())
    assert main(["map", str(log), "-o", str(out)]) == 0
    log.unlink()
    assert main(["evaluate", str(out), "--truth", str(truth)]) == 0
    evaluation = load(out / "evaluation.json")
    assert [name for name in FIGURES if evaluation[name] is None] == FIGURES[:4]
    assert "--log" in capsys.readouterr().out


def test_new_map_takes_the_old_evaluation_away(world: Path, tmp_path: Path) -> None:
    for _ in range(2):
        assert main(["map", str(world), "-o", str(tmp_path)]) == 0
        assert names(tmp_path) == RESULT_FILES
        assert main(["evaluate", str(tmp_path), "--truth", str(world)]) == 0


def test_mrpt_log_against_its_truth(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "mrpt-kf-slam"
    log, truth = folder / "kf-slam_demo.observations.csv.gz", "kf-slam_demo_ground_truth.txt"
    assert main(["map", str(log), "-o", str(tmp_path), "--association", "known"]) == 0
    assert load(tmp_path / "summary.json")["dimensions"] == 2
    assert main(["evaluate", str(tmp_path), "--truth", str(folder / truth)]) == 0
    evaluation = load(tmp_path / "evaluation.json")
    assert evaluation["landmark_rmse_m"] < 0.1
    assert evaluation["coverage"] > 0.9
    assert evaluation["counts"]["matched_poses"] > 200
