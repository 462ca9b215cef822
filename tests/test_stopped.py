"""Verbs that are stopped at system calls which change files, by a kill or a full disk."""

from __future__ import annotations

import platform
import sys
from pathlib import Path

import pytest

from tests.commands import run_process

pytestmark = pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"), reason="not Linux on x86-64"
)


def test_a_stopped_verb_leaves_whole_files_and_can_be_continued(
    child_env: dict[str, str], repo_root: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "tests.stopping", "--root", str(tmp_path)]
    done = run_process(
        [*command, "--every", "19", "--full", "31", "map-journal", "simulate-world"],
        env=child_env | {"OMP_NUM_THREADS": "1"},
        cwd=repo_root,
    )
    if "processes may not be traced here" in done.stderr:
        pytest.skip("processes may not be traced here")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "map-journal: " in done.stdout
    assert "simulate-world: " in done.stdout
