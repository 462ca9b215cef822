"""``relmap compare``: the table, the files, and one line per error."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from relmap.cli import main
from relmap.cli.compare import HELP
from relmap.comparison.compare import CSV_COLUMNS, compare, interrupts_blocked
from relmap.comparison.methods.registry import METHODS, MethodInfo, find_method
from relmap.comparison.methods.running import run_method
from relmap.evaluation.feeding import Association
from relmap.evaluation.sources import Data, EightSource
from tests.commands import GOOD, PATIENCE_S, RELMAP, Check, names, table

pytestmark = pytest.mark.usefixtures("unrendered")

ASSOCIATIONS: tuple[Association, ...] = ("known", "nearest")
SHORT = ["compare", "--simulate", "figure-eight", "--iterations", "60"]


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory, unrendered: None) -> Path:
    """A comparison, each method in its process; what it printed is beside it."""
    folder = tmp_path_factory.mktemp("compare")
    printed, complained = StringIO(), StringIO()
    with chdir(folder), redirect_stdout(printed), redirect_stderr(complained):
        assert main([*SHORT, "--methods", "relmap-points,ekf", "-o", "out"]) == 0
    assert complained.getvalue() == ""
    (folder / "printed").write_text(printed.getvalue())
    return folder


def test_files(compared: Path) -> None:
    assert names(compared / "out") == [
        "comparison.csv",
        "comparison.png",
        "map-ekf.csv",
        "map-ekf.png",
        "map-relmap-points.csv",
        "map-relmap-points.png",
        "trajectory-ekf.tum",
        "trajectory-relmap-points.tum",
    ]
    for picture in (compared / "out").glob("*.png"):
        assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_map_of_each_method_is_written(compared: Path) -> None:
    (batch, *_), rows = (
        table(compared / "out" / f"map-{name}.csv") for name in ("ekf", "relmap-points")
    )
    assert list(batch) == ["landmark", "x", "y", "z"]
    of = {row["method"]: row for row in table(compared / "out" / "comparison.csv")}
    assert len(rows) == int(float(of["relmap-points"]["matched"]))


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize(
    "truth",
    [
        "7,1,0,0,static\n8,0,2,0,static\n",
        "0,1,0,0,static\n",
        "0,1,0,0,static\n1,0,900,0,static\n2,-1e6,0,3,static\n",
        "0,1,0,0,static\n1,1,0,0,static\n2,1,0,0,static\n",
        "0,1,0,0,dynamic\n1,0,2,0,dynamic\n2,0,0,3,dynamic\n",
    ],
    ids=["others", "one", "far off", "in one place", "moving"],
)
def test_a_map_too_wrong_to_match_has_figures_and_no_traceback(place: Path, truth: str) -> None:
    lines = GOOD.splitlines()
    rows = [f"{line},{k % 4}" for k, line in enumerate(lines[1:])]
    (place / "log.csv").write_text("\n".join([f"{lines[0]},id", *rows]))
    (place / "truth" / "landmarks.csv").write_text("landmark,x,y,z,status\n" + truth)
    assert main(["compare", "log.csv", "--methods", "relmap-points-live,batch", "-o", "c"]) == 0
    for row in table(place / "c" / "comparison.csv"):
        assert float(row["total_s"]) > 0
        assert row["note"] == ""


def test_csv_holds_every_figure_in_full(compared: Path) -> None:
    rows = table(compared / "out" / "comparison.csv")
    assert list(rows[0]) == list(CSV_COLUMNS)
    assert [row["method"] for row in rows] == ["relmap-points", "ekf"]
    for row in rows:
        assert row["association"] == "known"
        assert 0.005 < float(row["landmark_rmse_m"]) < 0.1
        assert row["corner_rmse_m"] == ""
        assert row["note"] == ""
        assert float(row["coverage"]) == 1.0
        assert float(row["memory_mb"]) >= 0.0 if sys.platform == "linux" else True
        for name in ("ate_m", "rpe_m", "median_ms", "mean_ms", "last_100_median_ms", "total_s"):
            assert float(row[name]) > 0


def test_printed_table_agrees_with_the_csv(compared: Path) -> None:
    lines = (compared / "printed").read_text().splitlines()
    assert lines[0] == (
        "figure eight, density 25, gaussian noise 0.05 m, 60 iterations, seed 0; association known"
    )
    assert lines[1].split()[:5] == ["method", "RMSE", "of", "RMSE10", "cover"]
    for line, row in zip(lines[3:], table(compared / "out" / "comparison.csv"), strict=False):
        cells = line.split()
        assert cells[0] == row["method"]
        assert cells[1] == f"{float(row['landmark_rmse_m']):.4f}"
        assert len(line) <= 100
    assert lines[-1] == "wrote comparison.csv, 2 trajectories and maps and 3 pictures to out"


@pytest.mark.usefixtures("in_process")
def test_a_log_with_its_truth_beside_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    eight = str(tmp_path / "eight")
    assert main(["simulate", "figure-eight", "--iterations", "50", "-o", eight]) == 0
    out = tmp_path / "out"
    arguments = ["--association", "nearest", "--scans", "0:40", "-o", str(out)]
    assert main(["compare", eight, "--methods", "relmap-points-live", *arguments]) == 0
    assert "iterations 0:40; association nearest" in capsys.readouterr().out
    (row,) = table(out / "comparison.csv")
    assert float(row["landmark_rmse_m"]) < 0.1
    assert float(row["purity"]) == 1.0


@pytest.mark.usefixtures("in_process")
def test_a_log_without_truth(place: Path) -> None:
    (place / "truth" / "landmarks.csv").unlink()
    (place / "truth").rmdir()
    assert main(["compare", "log.csv", "--methods", "relmap-points-live", "-o", "c"]) == 0
    (row,) = table(place / "c" / "comparison.csv")
    assert row["landmark_rmse_m"] == row["ate_m"] == ""
    assert float(row["total_s"]) > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "either INPUT, a log, or --simulate"),
        (["log.csv", "--simulate", "building"], "either INPUT, a log, or --simulate"),
        (["log.csv", "--methods", "ekv"], "unknown method 'ekv'; did you mean ekf?"),
        (["log.csv", "--methods", "ekf"], "needs known ids: --association known"),
        (["log.csv", "--association", "known"], "needs a log with ids"),
        (["log.csv", "--methods", "relmap-planes"], "cannot map a log of landmarks"),
        (["log.csv", "--methods", "relmap-points,relmap-points"], "is named twice"),
        (["nowhere.csv"], "nowhere.csv"),
        (["log.csv", "--truth", "nowhere"], "nowhere"),
        (["log.csv", "--sigma", "-1"], "--sigma is -1.0"),
        (["log.csv", "--sigma", "0"], "--sigma is 0.0"),
        (["log.csv", "--density", "100"], "are for --simulate"),
        (["--simulate", "building", "--dynamic", "0.4"], "for the figure eight"),
        (["--simulate", "figure-eight", "--dynamic", "2"], "dynamic is 2.0"),
        (["--simulate", "figure-eight", "--truth", "truth"], "are for INPUT"),
    ],
)
def test_refused_in_one_line(refused: Check, arguments: list[str], said: str) -> None:
    assert said in refused("compare", *arguments, "-o", "c")


@pytest.mark.usefixtures("in_process")
def test_missing_methods_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = "gtsam is not installed: pip install 'relmap[peers]'"
    monkeypatch.setattr(
        MethodInfo, "missing", property(lambda self: missing if self.needs else None)
    )
    chosen = ["--methods", "isam2,frame-to-map", "-o", str(tmp_path)]
    assert main([*SHORT, *chosen]) == 0
    printed = capsys.readouterr()
    assert f"isam2: not run: {missing}" in printed.out
    assert printed.err == ""
    notes = [row["note"] for row in table(tmp_path / "comparison.csv")]
    assert notes == [f"not run: {missing}", ""]
    assert main([*SHORT, "--methods", "isam2", "-o", str(tmp_path / "none")]) == 2
    assert not (tmp_path / "none").exists()


def test_failures_of_one_method_are_reported_for_it() -> None:
    """Three landmarks in two iterations: too few for batch least squares."""
    source = EightSource(density=0.3, iterations=3)
    rows = list(compare(source, [find_method("batch"), find_method("frame-to-frame")], "known"))
    assert rows[0].run is None
    assert rows[0].note.startswith("failed: ")
    assert rows[1].run is not None


def test_help_names_every_method() -> None:
    for method in METHODS:
        assert method.name in HELP


def test_an_interrupt_while_a_process_starts_comes_after_it() -> None:
    started = []

    def start() -> None:
        with interrupts_blocked():
            signal.pthread_kill(threading.get_ident(), signal.SIGINT)
            started.append(True)

    with pytest.raises(KeyboardInterrupt):
        start()
    assert started


def test_interrupted_at_once(tmp_path: Path, child_env: dict[str, str]) -> None:
    """Ctrl-C reaches every process of the terminal; nothing is left behind, running or written."""
    process = subprocess.Popen(
        [*RELMAP, "compare", "--simulate", "figure-eight", "--methods", "ekf", "-o", "out"],
        cwd=tmp_path,
        env=child_env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not list(tmp_path.glob("out/.relmap-*")) and process.poll() is None:
        time.sleep(0.02)
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)
    printed, complained = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert printed == ""
    assert complained == "relmap: interrupted\n"
    assert names(tmp_path) == []
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("a process was left behind")


def test_a_map_in_submaps_is_judged_by_the_largest() -> None:
    """Nothing that is seen before iteration 50 is seen after 65, and nothing in between."""
    world = EightSource(iterations=90, sigma=0.02).load()
    log = world.log
    early, late = log.iteration < 50, log.iteration >= 65
    kept = early | (late & ~np.isin(log.ids, log.ids[early]))
    parted = log.only(kept)
    for association in ASSOCIATIONS:
        data = Data(parted, world.truth)
        run = run_method(find_method("relmap-points"), data, association)
        assert len(run.result.poses) == 50
        assert run.figures["path_coverage"] == pytest.approx(50 / 90)
        assert 0.8 < (run.figures["coverage"] or 0) < 1.0
        for name in ("landmark_rmse_m", "ate_m"):
            assert 0 < (run.figures[name] or 1) < 0.02
