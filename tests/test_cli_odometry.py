"""``--odometry`` of ``relmap map``, and its storage in a journal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap.cli import main
from relmap.io.journal import JournalReader

pytestmark = pytest.mark.usefixtures("unrendered")

LOG = "iteration,x,y\n" + "".join(
    f"{k},{x - 0.1 * k},{y}\n" for k in range(8) for x, y in ((1, 2), (3, 1), (2, -2), (4, 0))
)
MOVED = "iteration,x,y,yaw\n" + "".join(f"{k},0.1,0,0\n" for k in range(1, 8))


def told(journal: Path) -> list[float | None]:
    """Return how far ahead each motion in a journal goes; None where there is none."""
    with JournalReader(journal) as reader:
        motions = [scan.odometry for scan in reader.scans()]
    known = [None if T is None or np.isnan(T).any() else T for T in motions]
    return [None if T is None else float(T[0, 3]) for T in known]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "observations.csv").write_text(LOG)
    (tmp_path / "odometry.csv").write_text(MOVED)
    return tmp_path


@pytest.mark.parametrize(
    ("options", "motions"),
    [
        ([], [None] + [0.1] * 7),
        (["--odometry", "auto", "--scans", "2:6"], [None] + [0.1] * 3),
        (["--odometry", "none"], [None] * 8),
    ],
)
def test_odometry_of_the_log_is_used_or_not(
    here: Path, options: list[str], motions: list[float | None]
) -> None:
    assert main(["map", "observations.csv", "-o", "out", "--journal", "run", *options]) == 0
    assert told(here / "run") == motions


@pytest.mark.parametrize(("odometry", "motions"), [("auto", [0.1] * 7), ("none", [None] * 7)])
def test_resume_uses_the_odometry_of_the_journal(
    here: Path, odometry: str, motions: list[float | None]
) -> None:
    whole = ["map", "observations.csv", "-o", "out", "--odometry", odometry]
    assert main([*whole, "--journal", "run", "--scans", "0:4"]) == 0
    assert main(["resume", "run"]) == 0
    assert told(here / "run") == [None, *motions[:3]]
    assert main([*whole, "--journal", "whole"]) == 0
    assert told(here / "whole") == [None, *motions]


def test_a_corrected_path_is_reported_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ranges = 2 / np.cos(np.linspace(-1.2, 1.2, 90))
    beams = " ".join(f"{r:.3f}" for r in ranges)
    lines = (f"FLASER 90 {beams} {k} 0 0 {k} 0 0 {k} host {k}\n" for k in range(12))
    (tmp_path / "a.log").write_text("".join(lines))
    assert main(["map", "a.log", "-o", "out", "--variant", "planes"]) == 0
    told_by_default = capsys.readouterr().err
    assert "a.log: mapped without odometry: its odometry field may contain" in told_by_default
    assert main(["map", "a.log", "-o", "out", "--variant", "planes", "--odometry", "none"]) == 0
    assert "odometry" not in capsys.readouterr().err


def test_a_damaged_file_is_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "odometry.csv").write_text(MOVED + "8,far,0,0\n")
    assert main(["map", "observations.csv", "-o", "out"]) == 2
    assert "odometry.csv: line 9, field x: 'far' is not a number" in capsys.readouterr().err
    assert not (here / "out").exists()


def test_the_closing_line_reports_the_use_of_odometry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    eight, out = tmp_path / "eight", str(tmp_path / "out")
    simulate = ["simulate", "figure-eight", "-o", str(eight), "--iterations", "200"]
    assert main([*simulate, "--density", "3", "--odometry", "0.01:0.1"]) == 0
    capsys.readouterr()
    assert main(["map", str(eight), "-o", out]) == 0
    assert "scans are linked by odometry alone" in capsys.readouterr().out
    assert main(["map", str(eight), "-o", out, "--odometry", "none"]) == 0
    assert "odometry alone" not in capsys.readouterr().out
