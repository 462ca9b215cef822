"""The SQLite file of a journal: created atomically, and opened for writing."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from relmap.core.errors import RelmapError, reason
from relmap.io.journal.layout import APPLICATION, END, SCHEMA, End, Layout, meta_checksum

CACHE_KIB = 16384
"""Pages cached in memory before a write: a second of mapping produces some 3 MB."""
CHECKPOINT_PAGES = 4000
"""Pages in the write-ahead log that trigger a checkpoint."""

BESIDE = ("-wal", "-shm")
"""How names of the files end that SQLite keeps beside its own."""
THERE = "journal {} already exists: resume its run, or name another"


def create_file(path: Path, layout: Layout, meta: dict[str, Any]) -> End:
    """Create an empty journal atomically, and return its end; RelmapError if it cannot be done."""
    if os.path.exists(path):
        raise RelmapError(THERE.format(path))
    # Files left by a killed run beside a deleted journal would be taken for this one's.
    remove(path, BESIDE)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with closing(connected(part, new=True)) as connection:
            connection.execute("BEGIN")
            for statement in layout.tables.values():
                connection.execute(statement)
            rows = [(key, json.dumps(value)) for key, value in meta.items() if key != END]
            end = End(0, meta_checksum(rows))
            connection.executemany("INSERT INTO meta VALUES (?, ?)", [*rows, (END, end.text)])
            connection.execute(f"PRAGMA application_id = {APPLICATION}")
            connection.execute(f"PRAGMA user_version = {SCHEMA}")
            connection.execute("COMMIT")
        try:
            path.hardlink_to(part)
        except FileExistsError:
            raise
        except OSError:  # a file system without hard links
            part.replace(path)
    except FileExistsError as error:
        raise RelmapError(THERE.format(path)) from error
    except (sqlite3.Error, OSError) as error:
        raise RelmapError(f"journal {path} cannot be written: {reason(error)}") from error
    finally:
        remove(part)
    return end


def remove(path: Path, endings: tuple[str, ...] = ("", *BESIDE)) -> None:
    """Remove an SQLite file and its auxiliary files, if they exist."""
    for ending in endings:
        with suppress(OSError):
            path.with_name(path.name + ending).unlink()


def connected(path: Path, new: bool = False) -> sqlite3.Connection:
    """Open an SQLite file for writing, with durable commits."""
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


def stated_size(path: Path) -> int:
    """Return the size in bytes of an SQLite file according to its header; 0 if unknown."""
    with path.open("rb") as stream:
        head = stream.read(100)
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0"):
        return 0
    page = int.from_bytes(head[16:18], "big")
    return (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
