"""Verbs that are stopped at calls which change files, by a kill or a full disk."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.commands import run_process


def test_a_stopped_verb_leaves_whole_files_and_can_be_continued(
    child_env: dict[str, str], repo_root: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "tests.stopping", "--root", str(tmp_path)]
    done = run_process(
        [*command, "--every", "7", "--full", "5", "map-journal", "simulate-world"],
        env=child_env | {"OMP_NUM_THREADS": "1"},
        cwd=repo_root,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "map-journal: " in done.stdout
    assert "simulate-world: " in done.stdout
