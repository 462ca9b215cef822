"""Runs that are killed, run out of disk or are stopped by Ctrl-C, and how they continue."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from relmap.cli import main
from relmap.datasets import write_observation_csv, write_scans_npz
from relmap.io.journal.file import create_file
from relmap.io.journal.layout import POINTS
from relmap.plots import bench as plots_bench
from relmap.plots.bench_recorder import BenchFrame
from relmap.simulation import simulate_building, simulate_figure_eight
from tests.commands import GOOD, load, names, run_changed, run_process, table, unrendered
from tests.journals import end_after, kill_after

SAME = ["landmarks.csv", "map.ply", "mapper.npz", "submaps.csv", "tracks.csv.gz", "trajectory.tum"]


def test_runs_killed_at_random_moments_end_as_if_nothing_had_happened(
    tmp_path: Path, child_env: dict[str, str], repo_root: Path
) -> None:
    done = run_process(
        [sys.executable, "-m", "tests.killing", str(tmp_path), "12"],
        env=child_env | {"OMP_NUM_THREADS": "1"},
        cwd=repo_root,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert len(told) == 12
    assert all(run["same"] for run in told)
    assert all(run["held"] >= run["flushed"] for run in told)
    # The moments were spread over the runs.
    assert sum(run["killed"] for run in told) >= 5
    assert len({run["held"] for run in told}) >= 4


@pytest.fixture(scope="module")
def eight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log, and the result of mapping it without a stop."""
    folder = tmp_path_factory.mktemp("eight")
    write_observation_csv(folder / "log.csv", simulate_figure_eight(seed=3, iterations=200).log)
    with unrendered():
        assert main(["map", str(folder / "log.csv"), "-o", str(folder / "whole")]) == 0
    return folder


def same(result: Path, whole: Path) -> bool:
    return all((result / name).read_bytes() == (whole / name).read_bytes() for name in SAME)


@unrendered()
def test_resume_says_where_it_wrote(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text(GOOD)
    Path("elsewhere").mkdir()
    assert main(["map", "log.csv", "-o", "out", "--journal", "run.journal"]) == 0
    assert main(["resume", "run.journal"]) == 0
    assert capsys.readouterr().out.count(" files to out: ") == 2
    monkeypatch.chdir("elsewhere")
    assert main(["resume", "../run.journal"]) == 0
    assert f" files to {tmp_path / 'out'}: " in capsys.readouterr().out


@unrendered()
def test_relmap_resume_after_a_kill(
    eight: Path, tmp_path: Path, child_env: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    journal = tmp_path / "run.journal"
    out = tmp_path / "out"
    kill_after(70, journal, f"map log.csv -o {out}", env=child_env, cwd=eight)
    assert not (tmp_path / "out" / "summary.json").exists()
    assert main(["resume", str(journal)]) == 0
    assert same(tmp_path / "out", eight / "whole")
    assert main(["resume", str(journal), "-o", str(tmp_path / "again")]) == 0
    assert "none of them new" in capsys.readouterr().out
    assert same(tmp_path / "again", eight / "whole")


@unrendered()
def test_relmap_resume_with_ids_and_an_interval(eight: Path, tmp_path: Path) -> None:
    log, journal = str(eight / "log.csv"), str(tmp_path / "run.journal")
    asked = ["map", log, "--association", "known", "--scans", "20:90", "--no-refine", "-o"]
    assert main([*asked, str(tmp_path / "out"), "--journal", journal]) == 0
    end_after(Path(journal), 30)
    assert main(["resume", journal, "-o", str(tmp_path / "again")]) == 0
    assert same(tmp_path / "again", tmp_path / "out")
    summaries = [load(tmp_path / name / "summary.json") for name in ("out", "again")]
    for summary in summaries:
        del summary["timing"]
    assert summaries[0] == summaries[1]


def test_relmap_resume_of_walls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scans = simulate_building(seed=0, points=100, iterations=12).scans
    points, stamps_s = [scan.points for scan in scans], np.arange(12.0)
    write_scans_npz(tmp_path / "scans.npz", points, stamps_s)
    asked = ["map", "scans.npz", "--variant", "planes", "-o"]
    assert main([*asked, "whole"]) == 0
    with unrendered():
        assert main([*asked, "out", "--journal", "run.journal"]) == 0
    end_after(Path("run.journal"), 7)
    assert main(["resume", "run.journal", "-o", "again"]) == 0
    for name in ("planes.csv", "bench.png", "map.png", *SAME):
        assert Path("again", name).read_bytes() == Path("whole", name).read_bytes()
    write_scans_npz(tmp_path / "scans.npz", points[:6], stamps_s[:6])
    assert main(["resume", "run.journal"]) == 2


def test_the_animation_of_a_resumed_run_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[list[object]] = []

    def show(path: Path, frames: list[BenchFrame], *_: object) -> None:
        shown.append([row for frame in frames for row in frame.rows()])

    monkeypatch.setattr(plots_bench, "write_bench_gif", show)
    monkeypatch.setattr(plots_bench, "plot_bench", lambda *_: Figure())
    monkeypatch.chdir(tmp_path)
    points = [scan.points for scan in simulate_building(seed=0, points=100, iterations=12).scans]
    write_scans_npz(tmp_path / "scans.npz", points, np.arange(12.0))
    asked = ["map", "scans.npz", "--variant", "planes", "--animate", "-o", "out"]
    assert main([*asked, "--journal", "run.journal"]) == 0
    for held in (12, 7):
        end_after(Path("run.journal"), held)
        assert main(["resume", "run.journal"]) == 0
        assert shown[-1] == shown[0]
    assert len(shown[0]) > 12 * 100


@unrendered()
def test_relmap_resume_reports_errors(
    eight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, journal = tmp_path / "log.csv", tmp_path / "run.journal"
    log.write_bytes((eight / "log.csv").read_bytes())
    assert main(["map", str(log), "-o", str(tmp_path / "out"), "--journal", str(journal)]) == 0
    capsys.readouterr()

    def refused(*arguments: str) -> str:
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert said.startswith("relmap: error: ")
        assert said.count("\n") == 1
        return said

    assert "already exists" in refused("map", str(log), "-o", "x", "--journal", str(journal))
    assert "there is no journal" in refused("resume", str(tmp_path / "none"))
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[:40] + lines[41:]))
    assert "is not the log of journal" in refused("resume", str(journal))
    log.unlink()
    assert str(log) in refused("resume", str(journal))
    log.write_text("".join(lines))
    data = bytearray(journal.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 5000] = bytes(5000)
    journal.write_bytes(data)
    assert "scans before can be recovered" in refused("resume", str(journal))
    assert main(["resume", str(journal), "--salvage"]) == 0
    assert "recovered " in capsys.readouterr().out
    assert same(tmp_path / "out", eight / "whole")
    meta = {"variant": "points", "configuration": {}}
    create_file(tmp_path / "own.journal", POINTS, meta)
    assert "PointMapper.resume" in refused("resume", str(tmp_path / "own.journal"))


@unrendered()
def test_a_disk_that_is_full_ends_a_run_with_one_line_and_it_can_be_resumed(
    eight: Path, tmp_path: Path, child_env: dict[str, str]
) -> None:
    journal = tmp_path / "run.journal"
    # No file of the child may grow beyond 100 KiB; the operating system reports this to SQLite.
    limit = """
from relmap.io.journal import writing
writing.INTERVAL_S = 0.0
resource.setrlimit(resource.RLIMIT_FSIZE, (100 * 1024, 100 * 1024))
"""
    command = ["map", "log.csv", "-o", tmp_path / "out", "--journal", journal]
    done = run_changed(limit, *command, env=child_env, cwd=eight)
    assert done.returncode == 2
    assert done.stderr.startswith(f"relmap: error: journal {journal} cannot be written: ")
    assert done.stderr.count("\n") == 1
    assert names(tmp_path) == ["run.journal"]
    assert main(["resume", str(journal)]) == 0
    assert same(tmp_path / "out", eight / "whole")


@unrendered()
@pytest.mark.usefixtures("eight")  # which compiles what the child runs
def test_ctrl_c_writes_what_was_mapped_so_far(tmp_path: Path, child_env: dict[str, str]) -> None:
    log = tmp_path / "observations.csv"
    write_observation_csv(log, simulate_figure_eight(seed=1, iterations=90).log)
    out, journal = tmp_path / "out", tmp_path / "run.journal"
    early = """
from relmap.points import PointMapper
update = PointMapper.update
def stopped(self, *scan, **more):
    if self.n_iterations == 60:
        os.kill(os.getpid(), signal.SIGINT)
    return update(self, *scan, **more)
PointMapper.update = stopped
"""
    command = ["map", log, "-o", out, "--journal", journal]
    done = run_changed(early, *command, env=child_env, cwd=tmp_path)
    said = done.stdout
    assert (done.returncode, done.stderr) == (130, "relmap: interrupted\n")
    summary = load(out / "summary.json")
    n = summary["counts"]["iterations"]
    assert summary["interrupted"]
    assert n == 61
    assert said.startswith(f"stopped after {n} of 90: wrote ")
    assert f"'relmap resume {journal}' continues it" in said
    assert len(table(out / "landmarks.csv")) > 0
    part, whole = tmp_path / "part", tmp_path / "whole"
    assert main(["map", str(log), "-o", str(part), "--scans", f"0:{n}"]) == 0
    assert same(out, part)
    assert main(["resume", str(journal)]) == 0
    assert main(["map", str(log), "-o", str(whole)]) == 0
    assert same(out, whole)
    assert not load(out / "summary.json")["interrupted"]


def test_ctrl_c_twice_ends_at_once(tmp_path: Path, child_env: dict[str, str]) -> None:
    hanging = """
from relmap.points import PointMapper
def hang(self, *scan, **more):
    for _ in range(2):
        os.kill(os.getpid(), signal.SIGINT)
    raise AssertionError('not interrupted')
PointMapper.update = hang
"""
    (tmp_path / "log.csv").write_text("iteration,x,y\n0,1,2\n1,1,2\n")
    env = child_env | {"PYTHONDONTWRITEBYTECODE": "1"}
    done = run_changed(hanging, "map", "log.csv", "-o", "out", env=env, cwd=tmp_path)
    assert (done.returncode, done.stderr, done.stdout) == (130, "relmap: interrupted\n", "")
    assert names(tmp_path) == ["log.csv"]
