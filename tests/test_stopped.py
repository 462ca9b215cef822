"""Verbs that are stopped at calls which change files, by a kill or a full disk."""

from __future__ import annotations

import re
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
    for verb in ("map-journal", "simulate-world"):
        assert re.search(rf"^{verb}: [0-9]+ calls, [1-9]", done.stdout, re.MULTILINE)
    assert re.search(r" times (old|new|in part), then new: ", done.stdout)
    assert " times one line, old: " in done.stdout
