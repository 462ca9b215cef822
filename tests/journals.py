"""Journals as a run leaves them that ends early, and journals that were meddled with."""

from __future__ import annotations

import sqlite3
from itertools import islice
from pathlib import Path

from relmap.io.journal import Journal, JournalReader


def end_after(path: Path, n: int) -> None:
    """Make of a journal what it was after n scans."""
    with JournalReader(path) as reader:
        scans = list(islice(reader.scans(), n))
        layout, meta, calls = reader.layout, reader.meta, reader.calls
    path.unlink()
    shorter = Journal.create(path, layout, meta)
    for k, scan in enumerate(scans):
        for call in calls.get(k, []):
            shorter.call(call)
        shorter.append(**vars(scan))
    shorter.close()


def changed(path: Path, statement: str) -> None:
    """Change a journal as any tool that writes SQLite can."""
    connection = sqlite3.connect(path)
    with connection:
        connection.execute(statement)
    connection.close()
