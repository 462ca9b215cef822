"""The SQLite file of a journal: made whole or not at all, and opened for writing."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import suppress
from pathlib import Path
from typing import Any

from relmap.core.errors import RelmapError, reason
from relmap.io.journal.layout import APPLICATION, END, SCHEMA, End, Layout, meta_checksum

CACHE_KIB = 16384
"""Pages that wait in memory until then: a second of the mapping makes some 3 MB."""
CHECKPOINT_PAGES = 4000
"""Pages in the write-ahead log at which it is worked into the file."""


def create_file(path: Path, layout: Layout, meta: dict[str, Any]) -> End:
    """Make an empty journal, whole or not at all, and return where it ends.

    Raises
    ------
    RelmapError
        Where it cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        connection = connected(part, new=True)
        try:
            connection.execute("BEGIN")
            for statement in layout.tables.values():
                connection.execute(statement)
            rows = [(key, json.dumps(value)) for key, value in meta.items() if key != END]
            end = End(0, meta_checksum(rows))
            rows.append((END, end.text))
            connection.executemany("INSERT INTO meta VALUES (?, ?)", rows)
            connection.execute(f"PRAGMA application_id = {APPLICATION}")
            connection.execute(f"PRAGMA user_version = {SCHEMA}")
            connection.execute("COMMIT")
        finally:
            connection.close()
        part.replace(path)
    except (sqlite3.Error, OSError) as error:
        raise RelmapError(f"journal {path} cannot be written: {reason(error)}") from error
    finally:
        for name in (part.name, f"{part.name}-wal", f"{part.name}-shm"):
            with suppress(OSError):
                part.with_name(name).unlink(missing_ok=True)
    return end


def connected(path: Path, new: bool = False) -> sqlite3.Connection:
    """Open an SQLite file for writing; what a transaction commits is on disk."""
    mode = "rwc" if new else "rw"
    connection = sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}",
        uri=True,
        isolation_level=None,
        check_same_thread=False,
    )
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute(f"PRAGMA cache_size = -{CACHE_KIB}")
    connection.execute(f"PRAGMA wal_autocheckpoint = {CHECKPOINT_PAGES}")
    return connection
