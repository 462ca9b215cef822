"""``relmap sweep``: the grid, reproducible tables, and continuation after an interruption."""

from __future__ import annotations

import gc
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from joblib.externals.loky import get_reusable_executor

from relmap.cli import main
from relmap.comparison import sweep as sweep_module
from relmap.comparison.methods.running import ACCURACY
from relmap.comparison.sweep import TIMES, CellStore, Finished, accuracy_csv, run_cell, run_cells
from relmap.comparison.sweep_spec import KEYS, Cell, cells_of, varying
from relmap.core.errors import RelmapError
from tests.commands import PATIENCE_S, Check, names, table

pytestmark = pytest.mark.usefixtures("unrendered")

SPEC = """
method = ["relmap-points-live", "frame-to-map"]
sigma = [0.05, 0.1]
iterations = 40
seed = "0:2"
"""
N = 8
FIGURES: dict[str, float | None] = dict.fromkeys((*ACCURACY, *TIMES), 1.0)
NEEDS_DASK = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="no dask: pip install 'relmap[cluster]'"
)


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "grid.toml"
    path.write_text(SPEC)
    return path


@pytest.fixture(scope="module")
def expected() -> str:
    """The table, cell by cell in this process."""
    cells = cells_of(tomllib.loads(SPEC))
    return accuracy_csv(cells, [run_cell(cell)[1] for cell in cells])


def finished_cells(out: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (out / "cells").glob("*.json")}


def press_ctrl_c_after_3(patch: pytest.MonkeyPatch) -> None:
    save, saved = CellStore.save, list[Cell]()

    def counted(store: CellStore, cell: Cell, finished: Finished) -> None:
        save(store, cell, finished)
        saved.append(cell)
        if len(saved) == 3:
            os.kill(os.getpid(), signal.SIGINT)

    patch.setattr(CellStore, "save", counted)


@pytest.fixture
def workers_end() -> Iterator[None]:
    """End the workers of joblib after the test: they would wait for more work."""
    yield
    get_reusable_executor().shutdown()


@pytest.mark.usefixtures("workers_end")
def test_goes_on_after_an_interruption(
    spec: Path,
    tmp_path: Path,
    expected: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Begun in this process, ended by two workers: the same table as in one process."""
    out = tmp_path / "out"
    with pytest.MonkeyPatch.context() as patch:
        press_ctrl_c_after_3(patch)
        code = main(["sweep", str(spec), "-o", str(out), "--workers", "1"])
    complained = capsys.readouterr().err
    before = finished_cells(out)
    assert code == 130, complained
    assert 3 <= len(before) < N
    assert "the same command continues with the others" in complained
    assert "Traceback" not in complained
    assert not (out / "sweep.csv").exists()
    assert main(["sweep", str(spec), "-o", str(out), "--workers", "2"]) == 0
    printed = capsys.readouterr()
    assert f"{len(before)} of {N} cells were finished before" in printed.err
    after = finished_cells(out)
    assert len(after) == N
    assert {name: after[name] for name in before} == before
    assert (out / "sweep.csv").read_text() == expected
    lines = printed.out.splitlines()
    assert lines[0] == "medians over the seeds"
    assert lines[1].split()[:3] == ["method", "sigma", "RMSE"]
    assert len(lines) == 3 + 4 + 1
    assert lines[-1] == f"wrote {N} cells to {out}"
    timing = table(out / "timing.csv")
    assert len(timing) == N
    assert all(float(row["total_s"]) > 0 for row in timing)


@pytest.mark.usefixtures("workers_end")
def test_cancelled_cells_give_no_warning(
    spec: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    press_ctrl_c_after_3(monkeypatch)
    assert main(["sweep", str(spec), "-o", str(tmp_path / "out"), "--workers", "2"]) == 130
    gc.collect()
    assert [each for each in recwarn if "task iterator" in str(each.message)] == []


def test_medians_are_listed_by_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "grid.toml").write_text('method = "ekf"\ndensity = [100, 25, 3]\n')
    monkeypatch.setattr(
        sweep_module, "run_cells", lambda cells, *_: [(cell, Finished(FIGURES)) for cell in cells]
    )
    assert main(["sweep", str(tmp_path / "grid.toml"), "-o", str(tmp_path / "out")]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [row[1] for row in rows if row[0] == "ekf"] == ["3.0", "25.0", "100.0"]


def test_more_of_a_grid_runs_only_what_is_new(spec: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["sweep", str(spec), "-o", str(out), "--workers", "1"]) == 0
    before = finished_cells(out)
    spec.write_text(SPEC.replace("0:2", "0:3"))
    assert main(["sweep", str(spec), "-o", str(out), "--workers", "1"]) == 0
    after = finished_cells(out)
    assert len(after) == N + 4
    assert {name: after[name] for name in before} == before


def test_damaged_and_old_cells_are_run_again(tmp_path: Path) -> None:
    store, cell = CellStore(tmp_path), Cell()
    assert store.load(cell) is None
    store.save(cell, Finished(FIGURES))
    assert store.load(cell) == Finished(FIGURES)
    assert store.load(Cell(seed=1)) is None
    (path,) = (tmp_path / "cells").iterdir()
    told = json.loads(path.read_text())
    other = told["figures"] | {"total_s": 1e9}
    changed: tuple[dict[str, object], ...]
    changed = ({"version": "0.0.1"}, {"figures": {}}, {"figures": other}, {"note": "failed"})
    damaged = ("", "{", "[]", "[" * 100_000, "9" * 5000)
    for text in (*damaged, *(json.dumps(told | change) for change in changed)):
        path.write_text(text)
        assert store.load(cell) is None


def test_a_missing_extra_is_tried_again(tmp_path: Path) -> None:
    store = CellStore(tmp_path)
    store.save(Cell(), Finished(FIGURES, "not run: no gtsam", again=True))
    assert names(tmp_path / "cells") == []


def test_failures_are_listed_in_the_table() -> None:
    _, finished = run_cell(Cell(density=0.3, iterations=3, method="batch"))
    assert finished.note.startswith("failed: ")
    assert set(finished.figures.values()) == {None}


def test_grid() -> None:
    cells = cells_of({"method": ["ekf", "batch"], "sigma": [0.1, 1], "seed": "2:4"})
    assert len(cells) == 8
    assert len(set(cells)) == 8
    assert [c.method for c in cells[:2]] == ["ekf", "batch"]
    assert {c.seed for c in cells} == {2, 3}
    assert {c.sigma for c in cells} == {0.1, 1.0}
    assert varying(cells) == ["sigma"]
    assert list(KEYS)[-1] == "method"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"sigma": 0.1}, "no key method"),
        ({"method": "ekf", "sigmas": 0.1}, "unknown key 'sigmas'; did you mean sigma?"),
        ({"method": "ekv"}, "did you mean ekf?"),
        ({"method": ["ekf", "ekf"]}, "must list distinct values"),
        ({"method": []}, "must list distinct values"),
        ({"method": "ekf", "sigma": "low"}, "sigma is 'low'; it must be a number"),
        ({"method": "ekf", "seed": [0.5]}, "it must be a whole number"),
        ({"method": "ekf", "seed": True}, "it must be a whole number"),
        ({"method": "ekf", "seed": "3"}, "A:B"),
        ({"method": "ekf", "seed": "0:2000000"}, "the maximum is 1000000"),
        ({"method": "ekf", "sigma": -0.1}, "sigma is -0.1; it must be 0 to 1000 metres"),
        ({"method": "ekf", "sigma": float("nan")}, "sigma is nan"),
        ({"method": "ekf", "dynamic": [0.4, 40]}, "dynamic is 40.0; it must be a fraction"),
        ({"method": "ekf", "seed": [-1]}, "seed is -1"),
        ({"method": "ekf", "noise": "flat"}, "noise is 'flat'; it must be gaussian or uniform"),
        ({"method": "ekf", "world": "moon"}, "figure-eight or building"),
        ({"method": "ekf", "association": "nearest"}, "needs known ids"),
        ({"method": "relmap-planes", "world": "building"}, "association = 'nearest'"),
        (
            {"method": "relmap-planes", "world": "building", "density": 5},
            "applies only to the figure eight",
        ),
        ({"method": "relmap-planes"}, "cannot map a log of landmarks"),
        ({"method": "ekf", "sigma": 10**400}, "sigma is 1000.*; it must be 0 to 1000 metres"),
        ({"method": "ekf", "seed": 2**63}, "seed is 9223372036854775808; it must be 0 to"),
        ({"method": "ekf", "seed": 10**5000}, "seed is a number with thousands of digits"),
        ({"method": "ekf", "noise": [[10**5000]]}, "noise is .* thousands of digits"),
    ],
)
def test_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(RelmapError, match=said.replace("?", r"\?")):
        cells_of(given)


def test_refused_in_one_line(refused: Check, place: Path) -> None:
    assert "nowhere.toml" in refused("sweep", "nowhere.toml", "-o", "s")
    (place / "bad.toml").write_text("method = [")
    assert "bad.toml: not TOML" in refused("sweep", "bad.toml", "-o", "s")
    for text in (f"seed = {'9' * 5000}", f"seed = 0x{'f' * 5000}", f"seed = {'[' * 5000}"):
        (place / "bad.toml").write_text(f"method = 'ekf'\n{text}")
        assert "bad.toml: " in refused("sweep", "bad.toml", "-o", "s")
    (place / "good.toml").write_text(SPEC)
    assert "--workers is 0" in refused("sweep", "good.toml", "-o", "s", "--workers", "0")
    both = ["--workers", "2", "--dask", "tcp://127.0.0.1:1"]
    assert "--workers applies to this machine" in refused("sweep", "good.toml", "-o", "s", *both)


def test_a_killed_worker_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(cell: Cell) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(sweep_module, "run_cell", killed)
    with pytest.raises(RelmapError, match="a worker process of the sweep was killed"):
        list(run_cells([Cell(), Cell(seed=1)], 2))


@NEEDS_DASK
def test_on_a_cluster_that_loses_a_worker(
    spec: Path,
    tmp_path: Path,
    expected: str,
    child_env: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A scheduler and two workers on loopback; one of them is killed in the middle."""
    from distributed import Client

    address = tmp_path / "address.json"
    told = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    scheduler = dask(child_env, "scheduler", *told, "--scheduler-file", str(address))
    workers: list[subprocess.Popen[bytes]] = []
    try:
        at = address_in(address)
        alone = ["--no-nanny", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"]
        workers += [
            dask(child_env, "worker", at, *alone, "--local-directory", str(tmp_path))
            for _ in range(2)
        ]
        with Client(at, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=PATIENCE_S)
        save = CellStore.save

        def saved(store: CellStore, cell: Cell, finished: Finished) -> None:
            save(store, cell, finished)
            if len(finished_cells(tmp_path / "out")) == 2:
                assert workers[0].poll() is None
                workers[0].kill()

        monkeypatch.setattr(CellStore, "save", saved)
        monkeypatch.setattr(sweep_module, "PATIENCE_S", PATIENCE_S)
        assert main(["sweep", str(spec), "-o", str(tmp_path / "out"), "--dask", at]) == 0
        assert workers[0].poll() == -signal.SIGKILL
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()
    assert len(finished_cells(tmp_path / "out")) == N
    assert (tmp_path / "out" / "sweep.csv").read_text() == expected


def dask(env: dict[str, str], what: str, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments],
        env=env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def address_in(file: Path) -> str:
    """Return where a scheduler listens, once it has written that down."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if file.exists() and file.read_text().strip():
            address = json.loads(file.read_text())["address"]
            assert isinstance(address, str)
            return address
        time.sleep(0.1)
    raise AssertionError("the scheduler did not start")


@NEEDS_DASK
def test_no_scheduler(
    spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("relmap.comparison.sweep.PATIENCE_S", 1)
    arguments = ["-o", str(tmp_path / "out"), "--dask", "tcp://127.0.0.1:9"]
    assert main(["sweep", str(spec), *arguments]) == 2
    assert "no dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err
