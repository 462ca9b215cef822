"""``relmap map --columns``: tables with arbitrary column names, up to the result."""

from __future__ import annotations

import csv
import logging
from pathlib import Path

import numpy as np
import pytest

from relmap.cli import main
from relmap.io.files import read_tum
from relmap.io.results import read_result
from tests.commands import load

pytestmark = pytest.mark.usefixtures("unrendered")

PLACES = {"gate, left": (4, 2), "oak": (5, -2), "elm": (7, 1), "post": (3, -1), "bin": (8, 3)}
HEADER = "frame;seconds;ahead;left;what;score\n"
NAMES = "iteration=frame,stamp=seconds,x=ahead,y=left,id=what"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    rows = [
        f'{k};{100 + 0.5 * k};{x - 0.1 * k};{y};"{name}";0.9\n'
        for k in range(16)
        for name, (x, y) in PLACES.items()
    ]
    (tmp_path / "seen.csv").write_text(HEADER + "".join(rows))
    return tmp_path


def test_names_and_times_come_out_again(here: Path, caplog: pytest.LogCaptureFixture) -> None:
    command = ["map", "seen.csv", "-o", "out", "--columns", NAMES]
    assert main([*command, "--association", "known"]) == 0
    warned = [each.getMessage() for each in caplog.records if each.levelno >= logging.WARNING]
    assert warned == ["seen.csv: other columns are ignored: 'score'"]
    with (here / "out" / "names.csv").open(newline="") as file:
        names = {int(row["landmark"]): row["name"] for row in csv.DictReader(file)}
    assert names == dict(enumerate(sorted(PLACES)))
    stamps_s, _ = read_tum(here / "out" / "trajectory.tum")
    assert stamps_s.tolist() == [100 + 0.5 * k for k in range(16)]
    table = read_result(here / "out").landmarks
    found = {names[int(i)]: p for i, p in zip(table.landmark, table.position, strict=True)}
    across = found["oak"] - found["elm"]
    np.testing.assert_allclose(np.linalg.norm(across), np.hypot(2, 3), atol=1e-9)
    assert main(command) == 0
    assert not (here / "out" / "names.csv").exists()


def test_a_run_with_columns_is_gone_on_with(here: Path) -> None:
    command = ["map", "seen.csv", "--columns", NAMES, "--association", "known"]
    assert main([*command, "-o", "out", "--journal", "run", "--scans", "0:9"]) == 0
    assert main(["resume", "run", "-o", "again"]) == 0
    for name in ("landmarks.csv", "names.csv", "trajectory.tum"):
        assert (here / "again" / name).read_bytes() == (here / "out" / name).read_bytes()


@pytest.mark.usefixtures("in_process")
def test_every_verb_reads_a_table_with_columns(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["map", "seen.csv", "-o", "out", "--columns", NAMES, "--association", "known"]) == 0
    truth = [f"{k},{x},{y},0,static" for k, (_, (x, y)) in enumerate(sorted(PLACES.items()))]
    Path("truth").mkdir()
    Path("truth/landmarks.csv").write_text("\n".join(["landmark,x,y,z,status", *truth]))
    for log in ([], ["--log", "seen.csv"]):
        assert main(["evaluate", "out", "--truth", "truth", *log]) == 0
        assert load(here / "out" / "evaluation.json")["purity"] == 1.0
    assert main(["export", "out", "--to", "g2o", "--log", "seen.csv", "-o", "out/a.g2o"]) == 0
    localise = ["localise", "seen.csv", "--map", "out", "-o", "where"]
    assert main([*localise, "--columns", NAMES]) == 0
    assert "found 16 of 16 scans" in capsys.readouterr().out
    compare = ["compare", "seen.csv", "--methods", "relmap-points", "-o", "compared"]
    assert main([*compare, "--columns", NAMES]) == 0
    for command in (localise, compare):
        assert main([*command, "--columns", NAMES, "--format", "own-table"]) == 2
        assert "--columns applies only to tables of landmarks" in capsys.readouterr().err


def test_a_comparison_reports_ignored_columns_once(
    here: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    command = ["compare", "seen.csv", "--methods", "relmap-points", "-o", "compared"]
    assert main([*command, "--columns", NAMES]) == 0
    assert caplog.messages == ["seen.csv: other columns are ignored: 'score'"]
    assert capfd.readouterr().err.count("ignored") == 1  # the process of the method is silent


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--columns", "x"], "--columns is 'x': it must be pairs like x=px"),
        (["--columns", "x=a,x=b"], "it must be pairs like x=px"),
        (["--columns", "x=px,y=px"], "columns: 'px' is given twice"),
        (["--columns", "w=a"], "columns: 'w', expected some of iteration"),
        (["--columns", "x=far"], "no column 'far', expected one; there are 'frame'"),
        (
            ["--columns", NAMES, "--variant", "planes"],
            "--columns applies only to tables of landmarks",
        ),
        (
            ["--columns", NAMES, "--format", "own-table"],
            "--columns applies only to tables of landmarks",
        ),
    ],
)
def test_wrong_columns_are_refused(
    here: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["map", "seen.csv", "-o", "out", *options]) == 2
    assert message in capsys.readouterr().err
    assert not (here / "out").exists()


@pytest.mark.usefixtures("in_process")
def test_texts_mean_the_same_landmarks_in_a_log_added_to_a_map(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = Path("seen.csv").read_text().replace(HEADER, "iteration;stamp;x;y;id;score\n")
    Path("seen.csv").write_text(text)
    command = ["map", "seen.csv", "--columns", "id=id", "--association", "known"]
    assert main([*command, "-o", "out"]) == 0
    # An `alder`, first in the alphabet, gives all others other numbers in this log by itself.
    seen = Path("seen.csv").read_text()
    alder = "".join(f"{k};{100 + 0.5 * k};{6 - 0.1 * k};0;alder;0.9\n" for k in range(16))
    Path("seen.csv").write_text(seen + alder)
    assert main([*command, "-o", "more", "--onto", "out"]) == 0
    names = (here / "out" / "names.csv").read_text() + f"{len(PLACES)},alder\n"
    assert (here / "more" / "names.csv").read_text() == names
    was, now = (read_result(here / name).landmarks for name in ("out", "more"))
    np.testing.assert_array_equal(now.landmark, [*was.landmark, len(PLACES)])
    np.testing.assert_allclose(now.position[:-1], was.position, atol=1e-6)
    places = sorted({**PLACES, "alder": (6, 0)}.items())
    truth = [f"{k},{x},{y},0,static" for k, (_, (x, y)) in enumerate(places)]
    Path("truth").mkdir()
    Path("truth/landmarks.csv").write_text("\n".join(["landmark,x,y,z,status", *truth]))
    assert main(["evaluate", "more", "--truth", "truth"]) == 0
    assert load(here / "more" / "evaluation.json")["landmark_rmse_m"] < 1e-3
    numbers = here / "numbers.csv"
    numbers.write_text("iteration,x,y,id\n0,1,2,3\n")
    assert main(["map", "numbers.csv", *command[-2:], "-o", "no", "--onto", "out"]) == 2
    assert "numbers, those of the map out texts" in capsys.readouterr().err
    table = here / "out" / "names.csv"
    table.write_text(table.read_text().replace("\n1,", "\n7,"))
    assert main([*command, "-o", "no", "--onto", "out"]) == 2
    assert "names.csv: the landmarks are not numbered from 0" in capsys.readouterr().err
    assert main([*command, "-o", "no", "--onto", "nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err
