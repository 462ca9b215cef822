"""A run shown while it goes: recorded in a file, and read back by Rerun's own program."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from relmap import PointMapper
from relmap.cli import main
from relmap.core.errors import RelmapError
from relmap.plots import live
from relmap.plots.live import LiveView
from relmap.simulation import simulate_figure_eight
from tests.commands import PATIENCE_S

pytestmark = pytest.mark.usefixtures("unrendered")


def read_back(file: Path) -> dict[str, int]:
    """Return the number of chunks of each entity in a recording, according to `rerun`."""
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(file)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
        env=os.environ | {"CI": "true"},
    )
    names = re.findall(r"^Chunk\(.*?\) .*?- /(\w+)", done.stdout, re.MULTILINE)
    return {name: names.count(name) for name in names}


@pytest.mark.parametrize("source", ["csv/observations.csv", "csv", "flat", "npz"])
def test_a_run_is_recorded(logs: Path, tmp_path: Path, source: str) -> None:
    pytest.importorskip("rerun")
    file = tmp_path / "new" / "run.rrd"
    asked = ["map", str(logs / source), "-o", str(tmp_path / "out"), "--live-file", str(file)]
    variant = ["--variant", "planes"] if source == "npz" else []
    assert main([*asked, *variant]) == 0
    assert {"map", "path", "scan"} <= {*read_back(file)}


def test_planes_in_space_are_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun")
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "storey", "-o", "storey", "--iterations", "4"]) == 0
    asked = "map storey -o out --variant planes3d --live-file run.rrd"
    assert main(asked.split()) == 0
    assert {"map", "path", "scan"} <= {*read_back(Path("run.rrd"))}


def test_showing_takes_little_of_the_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock on which showing takes as long as four updates: one in forty is shown."""
    pytest.importorskip("rerun")
    now, shown = [0.0], list[int]()

    def show(view: LiveView, mapper: PointMapper) -> None:
        shown.append(int(now[0]))
        now[0] += 4.0

    monkeypatch.setattr(LiveView, "show", show)
    view, mapper = LiveView(tmp_path / "a.rrd", lambda: now[0]), PointMapper()
    for _ in view.watch(mapper, simulate_figure_eight(iterations=100).log.scans()):
        now[0] += 1.0
    view.close()
    assert shown == [1, 41, 81]


def test_usage_data_stays_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is started sees the variable that turns analytics off; afterwards it is as before."""
    rerun = pytest.importorskip("rerun")
    monkeypatch.delenv("CI", raising=False)
    seen = list[str | None]()
    monkeypatch.setattr(
        rerun.RecordingStream, "spawn", lambda *_, **__: seen.append(os.environ.get("CI"))
    )
    LiveView().close()
    assert seen == ["true"]
    assert "CI" not in os.environ
    monkeypatch.setenv("CI", "")
    LiveView().close()
    assert (seen, os.environ["CI"]) == (["true", "true"], "")


def test_without_the_viewer_one_line_says_what_to_install(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(live, "find_spec", lambda name: None)
    assert main(["map", str(logs / "csv"), "-o", str(tmp_path / "out"), "--live"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("pip install 'relmap[live]'")
    assert not (tmp_path / "out").exists()


def test_a_file_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    (tmp_path / "file").write_text("")
    with pytest.raises(RelmapError, match="not writable"):
        LiveView(tmp_path / "file" / "run.rrd")


def test_an_empty_map_is_shown(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    view = LiveView(tmp_path / "a.rrd")
    view.show(PointMapper())
    view.close()
    assert "map" in read_back(tmp_path / "a.rrd")
