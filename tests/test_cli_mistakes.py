"""Plausible mistakes of users: refused in one line, or said in the closing line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap.cli import main

pytestmark = pytest.mark.usefixtures("in_process", "unrendered")
RNG = np.random.default_rng(0)
PLACES = RNG.uniform(-8, 8, (20, 2))


def log(path: str, scale: float = 1.0, step_m: float = 0.1, d: int = 2, n: int = 12) -> None:
    """Write a log of 20 landmarks, seen n times by a robot that drives ahead."""
    scans = [PLACES - [step_m * k, 0] + RNG.normal(0, 0.01, (20, 2)) for k in range(n)]
    rows = [(k, *row) for k, scan in enumerate(scans) for row in (scale * scan).tolist()]
    rows = [(*row, 0.5 * (n % 3)) for n, row in enumerate(rows)] if d == 3 else rows
    text = "\n".join(",".join(map(str, row)) for row in rows)
    Path(path).write_text(f"iteration,x,y{',z' * (d - 2)}\n{text}\n")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", ["landmarks.csv", "submap-1.csv", "planes.csv"])
def test_a_result_does_not_replace_its_own_log(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    log(name)
    before = Path(name).read_bytes()
    assert main(["map", name, "-o", "."]) == 2
    said = f"log {name} would be overwritten by the result: write to another folder"
    assert said in capsys.readouterr().err
    assert Path(name).read_bytes() == before
    assert main(["map", name, "-o", "result"]) == 0
    log("seen.csv")
    assert main(["map", "seen.csv", "-o", "."]) == 0


def test_a_robot_that_stands_still_is_mentioned(capsys: pytest.CaptureFixture[str]) -> None:
    said = "in the map the robot moves less than 0.1 m: if it did move, the observations are not"
    for step_m in (0.0, 0.1):
        log("seen.csv", step_m=step_m)
        assert main(["map", "seen.csv", "-o", "out"]) == 0
        assert (said in capsys.readouterr().out) == (step_m == 0)


def test_landmarks_in_millimetres_are_mentioned(capsys: pytest.CaptureFixture[str]) -> None:
    for scale in (1.0, 1000.0):
        log("seen.csv", scale)
        assert main(["map", "seen.csv", "-o", "out"]) == 0
        assert ("coordinates must be in metres" in capsys.readouterr().err) == (scale > 1)


def test_an_added_log_of_another_scale_is_mentioned(capsys: pytest.CaptureFixture[str]) -> None:
    log("seen.csv", n=32)
    assert main(["map", "seen.csv", "-o", "out"]) == 0
    for scale, said in ((1.02, "longer"), (0.99, "shorter")):
        log("more.csv", scale, n=32)
        assert main(["map", "more.csv", "-o", "more", "--onto", "out"]) == 0
        assert f"% {said} than the earlier one" in capsys.readouterr().out
    log("more.csv", n=32)
    assert main(["map", "more.csv", "-o", "more", "--onto", "out"]) == 0
    assert "measures distances" not in capsys.readouterr().out


@pytest.mark.parametrize("n", [2, 7])
def test_points_of_range_0_are_left_out(n: int, capsys: pytest.CaptureFixture[str]) -> None:
    log("seen.csv")
    with Path("seen.csv").open("a") as file:
        file.writelines(f"{12 - k},0,0\n" for k in range(1, n + 1))
    assert main(["map", "seen.csv", "-o", "out"]) == 0
    printed = capsys.readouterr()
    said = "relmap: seen.csv: 7 points of range 0 left out: no detection\n"
    assert printed.err.endswith(said) == (n == 7)
    assert f"mapped from {240 if n == 7 else 242} observations" in printed.out


@pytest.mark.parametrize(("n", "which"), [(0, ""), (1, "1 scan repeats"), (4, "4 scans repeat")])
def test_scans_that_repeat_are_mentioned(
    n: int, which: str, capsys: pytest.CaptureFixture[str]
) -> None:
    log("seen.csv")
    last = [line.split(",", 1)[1] for line in Path("seen.csv").read_text().splitlines()[-20:]]
    with Path("seen.csv").open("a") as file:
        file.writelines(f"{12 + k},{point}\n" for k in range(n) for point in last)
    assert main(["map", "seen.csv", "-o", "out"]) == 0
    said = f"seen.csv: {which} the one before exactly: copies are not new measurements"
    assert (said in capsys.readouterr().err) == (n > 0)


def test_one_column_is_not_two_coordinates(capsys: pytest.CaptureFixture[str]) -> None:
    log("seen.csv")
    assert main(["map", "seen.csv", "-o", "out", "--columns", "x=y"]) == 2
    assert "seen.csv: columns: 'y' would be two coordinates" in capsys.readouterr().err
    assert main(["map", "seen.csv", "-o", "out", "--columns", "x=y,y=x"]) == 0


def test_the_noise_of_a_bearing_is_in_radians(capsys: pytest.CaptureFixture[str]) -> None:
    log("seen.csv")
    run = ["map", "seen.csv", "-o", "out", "--range-sigma", "0.6", "--bearing-sigma"]
    assert main([*run, "1"]) == 2
    assert "--bearing-sigma is 1.0; it must be below 0.5 radians" in capsys.readouterr().err
    assert main([*run, "0.02"]) == 0


def test_a_log_in_space_does_not_fit_a_planar_map(capsys: pytest.CaptureFixture[str]) -> None:
    log("flat.csv")
    log("seen.csv", d=3)
    assert main(["map", "flat.csv", "-o", "out"]) == 0
    for verb in (["localise", "seen.csv", "--map", "out"], ["map", "seen.csv", "--onto", "out"]):
        assert main([*verb, "-o", "other"]) == 2
        said = "relmap: error: the log seen.csv is in space, the map out planar\n"
        assert capsys.readouterr().err.endswith(said)


@pytest.mark.parametrize("step", ["100", "{k}"], ids=["millimetres", "poses"])
def test_odometry_that_holds_no_motions_in_metres_gets_advice(
    step: str, capsys: pytest.CaptureFixture[str]
) -> None:
    log("seen.csv")
    motions = "".join(f"{k},{step.format(k=k)},0,0\n" for k in range(1, 12))
    Path("odometry.csv").write_text(f"iteration,x,y,yaw\n{motions}")
    assert main(["map", "seen.csv", "-o", "out"]) == 0
    said = capsys.readouterr().out
    assert "was not used (it must be in metres and radians" in said
    assert "odometry.csv holds motions, not poses)" in said


def test_a_single_iteration_is_singular(capsys: pytest.CaptureFixture[str]) -> None:
    log("seen.csv")
    assert main(["map", "seen.csv", "-o", "out", "--scans", "0:1"]) == 0
    assert "20 observations in 1 iteration, " in capsys.readouterr().out


def test_warnings_begin_as_all_messages_do(capsys: pytest.CaptureFixture[str]) -> None:
    Path("table.csv").write_text("iteration,x,y,score\n0,1,2,3\n")
    assert main(["map", "table.csv", "-o", "out", "--columns", "x=x"]) == 0
    said = "\nrelmap: table.csv: other columns are ignored: 'score'\n"
    assert said in f"\n{capsys.readouterr().err}"
