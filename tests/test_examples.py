"""Every file of ``examples/`` runs."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.commands import run_process

FOLDER = Path(__file__).resolve().parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))


def run_file(path: Path, env: dict[str, str], folder: Path) -> None:
    """Run a Python file in a folder, in a separate interpreter; fail with what it said."""
    done = run_process([sys.executable, str(path)], env=env, cwd=folder)
    assert done.returncode == 0, f"{path.name} failed:\n{done.stdout}{done.stderr}"


def test_there_are_examples() -> None:
    assert EXAMPLES, f"{FOLDER} holds no example"


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_example_runs(path: Path, child_env: dict[str, str], tmp_path: Path) -> None:
    run_file(path, child_env, tmp_path)
