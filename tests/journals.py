"""Runs with journals; journals of runs that end early, and journals that were changed."""

from __future__ import annotations

import signal
import sqlite3
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from relmap import PointMapper
from relmap.io.journal import Journal, JournalReader
from tests.commands import run_changed
from tests.worlds import walk


def end_after(path: Path, n: int) -> None:
    """Truncate a journal to its state after n scans."""
    with JournalReader(path) as reader:
        scans = list(islice(reader.scans(), n))
        layout, meta, calls = reader.layout, reader.meta, reader.calls
    path.unlink()
    shorter = Journal.create(path, layout, meta)
    for k, scan in enumerate(scans):
        for call in calls.get(k, []):
            shorter.call(call)
        shorter.append(scan)
    shorter.close()


def kill_after(n: int, journal: Path, command: str, **more: Any) -> None:
    """Run `relmap` with a journal in a process that kills itself once n scans are in it."""
    change = f"""
from relmap.io.journal import writing
writing.INTERVAL_S = 0.0  # a flush for every scan
append = writing.Journal.append
def half(self, scan):
    append(self, scan)
    if self.n_scans == {n}:
        os.kill(os.getpid(), signal.SIGKILL)
writing.Journal.append = half
"""
    done = run_changed(change, *command.split(), "--journal", journal, **more)
    assert done.returncode == -signal.SIGKILL
    with JournalReader(journal) as reader:
        assert len(list(reader.scans())) == n


def changed(path: Path, statement: str) -> None:
    """Change a journal as any tool that writes SQLite can."""
    connection = sqlite3.connect(path)
    with connection:
        connection.execute(statement)
    connection.close()


def finished(mapper: PointMapper) -> tuple[bytes, ...]:
    """Return the results of a mapper after the rest of a run, to the last bit."""
    mapper.finish()
    before = mapper.map.positions.tobytes()
    mapper.refine()
    table = mapper.landmarks
    return before, mapper.map.positions.tobytes(), mapper.trajectory.tobytes(), table.sd.tobytes()


def scans_of(dimension: int, with_ids: bool) -> list[tuple[Any, Any]]:
    """Return scans, some of them empty, some with unidentified landmarks."""
    scans: list[tuple[Any, Any]] = []
    for k, (ids, points) in enumerate(walk(dimension, 7, 0.02).scans):
        known = np.where(np.arange(len(ids)) == k % 5, -1, ids) if with_ids else None
        scans.append((points, known))
    nothing = np.empty((0, dimension)), np.empty(0, dtype=np.int64) if with_ids else None
    scans[0] = scans[1] = scans[40] = nothing
    return scans


def run(mapper: PointMapper, scans: list[tuple[Any, Any]]) -> PointMapper:
    for points, ids in scans:
        mapper.update(points, ids)
    return mapper


def begun(path: Path, n: int = 60, close: bool = True) -> PointMapper:
    mapper = run(PointMapper(journal=path), scans_of(3, False)[:n])
    if close:
        mapper.close()
    return mapper
