"""Every block of the README runs exactly as written."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import numpy as np
import pytest

from relmap.comparison.sweep_spec import cells_of
from tests.commands import PATIENCE_S

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?<=\n\n)(?:    .*\n|\n(?=    ))+")

NOT_RUN = {
    "make demo": "sets up an environment of its own",
    "make test": "runs every test, this one too",
    "pip install .": "installs into the environment of whoever runs the tests",
    "relmap demo": "is run, exactly so, by test_cli_shell.test_demo",
}
"""Lines of shell blocks that are not run, and why."""
REAL_LOG = "relmap compare log.observations.csv.gz --truth log_ground_truth.txt -o real"


def blocks() -> list[tuple[str, str]]:
    """Return language and content of all blocks; indented ones are shell or TOML."""
    fenced = [(match[1], match[2]) for match in FENCED.finditer(README)]
    for match in INDENTED.finditer(FENCED.sub("", README)):
        text = textwrap.dedent(match[0])
        is_toml = all(re.match(r"\w+ = ", line) for line in text.splitlines() if line)
        fenced.append(("toml" if is_toml else "shell", text))
    return fenced


PYTHON = [text for language, text in blocks() if language == "python"]
SHELL = [text for language, text in blocks() if language == "shell"]
TOML = [text for language, text in blocks() if language == "toml"]


def test_every_block_is_of_a_kind_that_is_run() -> None:
    assert {language for language, _ in blocks()} == {"python", "shell", "toml"}
    assert (len(PYTHON), len(SHELL), len(TOML)) == (README.count("```python"), 5, 1)
    assert len(PYTHON) >= 3
    assert len(PYTHON[0].splitlines()) < 10
    lines = [line for text in SHELL for line in text.splitlines()]
    assert {line for line in lines if not line.startswith("relmap ")} <= {*NOT_RUN}
    assert {*NOT_RUN, REAL_LOG} <= {*lines}, "an exception is stale"


@pytest.mark.parametrize("number", range(len(PYTHON)))
def test_python_blocks_run_twice_and_print(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each by itself, and again in the folder that it left behind, with the same outcome."""
    monkeypatch.chdir(tmp_path)
    Path("block.py").write_text(PYTHON[number], encoding="utf-8")
    printed = []
    for _ in range(2):
        runpy.run_path("block.py", run_name="__main__")
        printed.append(capsys.readouterr().out)
    assert printed[0].strip()
    assert printed[0] == printed[1]


def test_the_block_of_long_runs_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (text,) = (text for text in PYTHON if "journal" in text)
    Path("block.py").write_text(text, encoding="utf-8")
    left = runpy.run_path("block.py", run_name="__main__")
    assert left["mapper"].n_iterations == len(left["scans"])
    assert np.isfinite(left["T_map_robot"]).all()


@pytest.fixture
def shell_env(child_env: dict[str, str], tmp_path: Path) -> dict[str, str]:
    """Return an environment in which `relmap` is the one under test."""
    shim = tmp_path / "bin" / "relmap"
    shim.parent.mkdir()
    shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m relmap.cli "$@"\n', encoding="utf-8")
    shim.chmod(0o755)
    return child_env | {"PATH": f"{shim.parent}{os.pathsep}{os.environ['PATH']}"}


def run_lines(lines: list[str], env: dict[str, str], folder: Path) -> str:
    """Run lines in a shell that ends at the first failure; return what they print."""
    done = subprocess.run(
        ["/bin/sh", "-e", "-c", "\n".join(lines)],
        env=env,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, f"{lines}:\n{done.stdout}{done.stderr}"
    return done.stdout


def of_shell(text: str) -> list[str]:
    """Return the lines of a block that are run wherever the tests are."""
    return [line for line in text.splitlines() if line not in (*NOT_RUN, REAL_LOG)]


@pytest.mark.parametrize(
    "lines", [lines for text in SHELL if (lines := of_shell(text))], ids=lambda lines: lines[0]
)
def test_shell_blocks_run(lines: list[str], shell_env: dict[str, str], tmp_path: Path) -> None:
    place = tmp_path / "place"
    place.mkdir()
    assert run_lines(lines, shell_env, place)
    for line in lines:
        for folder in re.findall(r"-o (\S+)", line):
            assert any((place / folder).iterdir())


def test_the_line_with_a_real_log_runs(
    shared_data: Path, shell_env: dict[str, str], tmp_path: Path
) -> None:
    for end in (".observations.csv.gz", "_ground_truth.txt", "_ground_truth_robot_path.txt"):
        source = shared_data / "mrpt-kf-slam" / f"kf-slam_demo{end}"
        shutil.copyfile(source, tmp_path / f"log{end}")
    printed = run_lines([REAL_LOG], shell_env, tmp_path)
    assert "wrote comparison.csv" in printed
    assert (tmp_path / "real" / "comparison.png").stat().st_size > 0


def test_the_sweep_is_a_grid_that_relmap_reads() -> None:
    assert len(cells_of(tomllib.loads(TOML[0]))) == 2 * 2 * 10
