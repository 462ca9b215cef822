"""Common parts of tests: hypothesis profiles, real data, an environment, folders."""

from __future__ import annotations

import gc
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import chdir
from functools import cache
from pathlib import Path

import pytest
import typer
from hypothesis import HealthCheck, settings

import relmap
from relmap.cli import console, main
from relmap.comparison.compare import Compared
from relmap.comparison.methods.registry import find_method
from relmap.comparison.methods.running import run_method
from relmap.datasets import open_scans
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import Association
from relmap.evaluation.sources import Source
from tests.commands import GOOD, Check, snapshot, unrendered
from tests.everyformat import NASTY, WALLS, Mapped, write_points, write_walls

os.environ["MPLBACKEND"] = "Agg"
# A shell starts what runs in the background without Ctrl-C, and so would be the tests' commands.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[1]

# No deadline and no limit on slow generation: the machine may be busy, the answer is the same.
for name, derandomize in (("dev", False), ("ci", True)):
    settings.register_profile(
        name,
        deadline=None,
        derandomize=derandomize,
        print_blob=True,
        suppress_health_check=[HealthCheck.too_slow],
    )
settings.load_profile(
    os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") == "true" else "dev")
)


def pytest_collection_finish() -> None:
    """Have the garbage collector, a tenth of the time, look at less and less often."""
    gc.freeze()
    gc.set_threshold(20_000, 10, 10)


@pytest.fixture(scope="session")
def repo_root() -> Path:
    """Return the root of the checkout."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real data sets.

    It is ``RELMAP_DATA`` where that is set, else ``../shared/data`` beside the checkout.  A test
    that asks for it is skipped where it is missing, and fails where ``CI`` is ``true``.
    """
    named = os.environ.get("RELMAP_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if folder.is_dir():
        return folder
    message = f"no real data: {folder} is not a folder; set RELMAP_DATA to where the data sets are"
    if os.environ.get("CI") == "true":
        pytest.fail(message)
    pytest.skip(message)


@pytest.fixture(scope="session")
def real_scans(shared_data: Path) -> Callable[[str], ScanLog]:
    """Return a function that opens scans of the real data sets; it reads none of them twice."""
    return cache(lambda name: open_scans(shared_data / name))


@pytest.fixture(scope="session", autouse=True)
def every_s() -> Iterator[float]:
    """Keep progress, which a busy machine prints, out of compared output; return its interval."""
    interval_s = console.EVERY_S
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(console, "EVERY_S", 1e6)
        yield interval_s


@pytest.fixture(scope="session", autouse=True)
def commands_built_once() -> Iterator[None]:
    """Build the parsers of the command line once: it takes longer than many a command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session")
def child_env() -> dict[str, str]:
    """Return an environment in which a subprocess imports the relmap that is under test here."""
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPATH": str(Path(relmap.__file__).resolve().parents[1])}


@pytest.fixture(scope="module", name="unrendered")
def unrendered_module() -> Iterator[None]:
    """Leave the pictures of all tests of a module unrendered."""
    with unrendered():
        yield


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `relmap compare` run its methods in this process: it is faster."""

    def run(name: str, source: Source, association: Association, sigma_m: float | None) -> Compared:
        return Compared(name, run_method(find_method(name), source.load(), association, sigma_m))

    monkeypatch.setattr("relmap.comparison.compare.in_own_process", run)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that all examples of a property use, one after the other."""
    return tmp_path_factory.mktemp("datasets")


@pytest.fixture(scope="session")
def placed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log, a truth and a result, which `place` copies."""
    folder = tmp_path_factory.mktemp("placed")
    (folder / "log.csv").write_text(GOOD)
    (folder / "truth").mkdir()
    (folder / "truth" / "landmarks.csv").write_text(
        "landmark,x,y,z,status\n0,1,0,0,static\n1,0,2,0,static\n2,0,0,3,static\n"
    )
    with chdir(folder), unrendered():
        assert main(["map", "log.csv", "-o", "out"]) == 0
        assert main(["evaluate", "out", "--truth", "truth"]) == 0
    return folder


@pytest.fixture
def place(placed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a log, a truth and a result; the working directory."""
    shutil.copytree(placed, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def refused(place: Path, capsys: pytest.CaptureFixture[str]) -> Check:
    """Run a command that must be refused and leave everything as it was; return its one line."""

    def check(*arguments: str) -> str:
        before = snapshot(place)
        capsys.readouterr()
        assert main(arguments) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.startswith("relmap: error: ")
        assert printed.err.endswith("\n")
        assert len(printed.err.splitlines()) == 1
        assert printed.err.isascii() or printed.err.strip().isprintable()
        assert snapshot(place) == before
        return printed.err

    return check


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with every format."""
    folder = tmp_path_factory.mktemp("formats")
    write_points(folder)
    write_walls(folder)
    return folder


@pytest.fixture(scope="session")
def mapped(logs: Path) -> Mapped:
    """Return a function that maps a log once and returns its result folder."""
    done: dict[str, Path] = {}

    def result_of(source: str) -> Path:
        if source not in done:
            walls = source in [name for _, name in WALLS]
            out = logs / "results" / str(len(done))
            variant = ["--variant", "planes"] if walls else []
            with unrendered():
                assert main(["map", str(logs / source), "-o", str(out), *variant]) == 0
            done[source] = out
        return done[source]

    return result_of


@pytest.fixture(scope="session")
def nasty(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a log whose name would be markup."""
    log = tmp_path_factory.mktemp("nasty") / NASTY
    log.write_bytes((logs / "flat/observations.csv").read_bytes())
    with unrendered():
        assert main(["map", str(log), "-o", str(log.parent / "out")]) == 0
    return log.parent / "out" / "report.html"
