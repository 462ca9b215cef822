"""The command line from a shell: the demo, help, progress, and how it ends."""

from __future__ import annotations

import errno
import os
import pty
import re
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from io import BytesIO, StringIO, TextIOWrapper
from pathlib import Path

import pytest

import relmap
from relmap.cli import demo, main
from relmap.datasets import FORMATS, write_observation_csv
from relmap.evaluation import sources
from relmap.simulation import simulate_figure_eight
from tests.commands import (
    GOOD,
    PATIENCE_S,
    RELMAP,
    RESULT_FILES,
    load,
    names,
    run_process,
)

USUAL = re.compile(r"relmap: .*(so far|left|half a minute|\d of \d+)")
"""A busy machine prints progress, and a new one that it compiles."""


def unusual(said: str) -> list[str]:
    return [line for line in said.splitlines() if not USUAL.fullmatch(line)]


def test_demo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "ITERATIONS", 5)
    monkeypatch.setattr(sources, "EightSource", partial(sources.EightSource, iterations=60))
    assert main(["demo"]) == 0
    printed = capsys.readouterr()
    assert unusual(printed.err) == []
    assert printed.out.splitlines()[-1] == "wrote index.html and the files behind it to relmap-demo"
    folder = tmp_path / "relmap-demo"
    result_files = sorted([*RESULT_FILES, "evaluation.json"])
    pictures = [f"building-{noise}-noise.png" for noise in ("little", "much")]
    made = [*result_files, *pictures, "index.html", "nearest", "observations.csv", "truth"]
    assert names(folder) == sorted(made)
    page = (folder / "index.html").read_text()
    assert all(f'src="{picture}"' in page for picture in ["map.png", "nearest/map.png", *pictures])
    assert names(folder / "nearest") == result_files
    assert load(folder / "evaluation.json")["landmark_rmse_m"] < 0.1


def run(
    arguments: list[str], folder: Path, env: dict[str, str]
) -> subprocess.CompletedProcess[str]:
    return run_process([*RELMAP, *arguments], env=env, cwd=folder)


def test_a_home_that_cannot_be_written_changes_nothing(
    tmp_path: Path, child_env: dict[str, str]
) -> None:
    simulated = simulate_figure_eight(seed=3, iterations=20).log
    write_observation_csv(tmp_path / "log.csv", simulated)
    assert main(["map", str(tmp_path / "log.csv"), "-o", str(tmp_path / "usual")]) == 0
    left_out = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR")
    env = {name: value for name, value in child_env.items() if name not in left_out}
    env["HOME"] = os.path.join(os.devnull, "home")
    done = run(["map", "log.csv", "-o", "out"], tmp_path, env)
    assert (done.returncode, unusual(done.stderr)) == (0, [])
    assert names(tmp_path / "out") == RESULT_FILES
    for name in ("map.png", "landmarks.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "usual" / name).read_bytes()


def test_version_and_help_from_a_shell(tmp_path: Path, child_env: dict[str, str]) -> None:
    assert run(["--version"], tmp_path, child_env).stdout == f"relmap {relmap.__version__}\n"
    bare, asked = run([], tmp_path, child_env), run(["--help"], tmp_path, child_env)
    assert bare.returncode == asked.returncode == 0
    assert bare.stdout == asked.stdout


@pytest.mark.parametrize(
    "verb",
    [
        [],
        ["simulate"],
        ["simulate", "figure-eight"],
        ["map"],
        ["evaluate"],
        ["figures"],
        ["demo"],
        ["resume"],
        ["localise"],
        ["export"],
        ["merge"],
    ],
)
def test_help_shows_an_example(verb: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*verb, "--help"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert f"Usage: {' '.join(['relmap', *verb])}" in printed.out
    if verb != ["simulate"]:
        assert "\n    relmap " in printed.out


def test_help_of_map_names_every_format(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "--help"]) == 0
    text = capsys.readouterr().out
    assert [name for name in FORMATS if name not in text] == []


def test_the_reader_of_the_output_is_gone(tmp_path: Path, child_env: dict[str, str]) -> None:
    child = subprocess.Popen(
        [*RELMAP, "--help"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=child_env,
        cwd=tmp_path,
    )
    child.stdout.close()
    assert child.stderr.read() == b""
    child.wait(timeout=PATIENCE_S)
    child.stderr.close()
    assert child.returncode in (0, 1)


class Full(StringIO):
    def write(self, text: str) -> int:
        raise OSError(errno.ENOSPC, "full")


def test_an_error_that_cannot_be_written_is_still_the_exit_code(tmp_path: Path) -> None:
    with redirect_stderr(Full()):
        assert main(["map", str(tmp_path / "none"), "-o", str(tmp_path / "out")]) == 2


@pytest.mark.parametrize("module", ["typer", "relmap.cli.sweep"])
def test_an_interrupt_while_modules_are_loaded_is_one_line(
    tmp_path: Path, child_env: dict[str, str], module: str
) -> None:
    code = (
        "import sys\n"
        "class Pressed:\n"
        "    def find_spec(self, name, *_):\n"
        f"        if name == {module!r}: raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Pressed())\n"
        "from relmap.cli import main\n"
        "sys.exit(main(['--version']))\n"
    )
    done = run_process([sys.executable, "-c", code], env=child_env, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "relmap: interrupted\n")


def test_progress_on_a_terminal_leaves_no_trace_behind(
    tmp_path: Path, child_env: dict[str, str]
) -> None:
    code = (
        "import relmap.cli.console as c, time\n"
        "c.PATIENCE_S = 0.0\n"
        "list(c.tracked(range(3), 3, 'mapping'))\n"
    )
    ours, theirs = pty.openpty()
    subprocess.run(
        [sys.executable, "-c", code],
        stderr=theirs,
        timeout=PATIENCE_S,
        check=True,
        env=child_env | {"TERM": "xterm"},
        cwd=tmp_path,
    )
    os.close(theirs)
    shown = os.read(ours, 100_000).decode()
    os.close(ours)
    assert "mapping" in shown
    assert shown.endswith("\x1b[2K")


def test_tracked_yields_everything_in_order() -> None:
    from relmap.cli.console import tracked

    assert list(tracked(range(5), 5, "mapping")) == list(range(5))


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_names_that_are_not_utf8_are_mapped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, encoding: str
) -> None:
    name = os.fsdecode(b"caf\xe9")
    (tmp_path / f"{name}.csv").write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    printed = TextIOWrapper(BytesIO(), encoding, "strict", write_through=True)
    with redirect_stdout(printed), redirect_stderr(StringIO()) as complained:
        assert main(["map", f"{name}.csv", "-o", name]) == 0
    assert unusual(complained.getvalue()) == []
    printed.seek(0)
    assert printed.read().startswith("wrote 9 files to caf")
    assert names(tmp_path / name) == RESULT_FILES
    assert "caf\\udce9.csv" in (tmp_path / name / "report.html").read_text(encoding="utf-8")
