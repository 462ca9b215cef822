"""Writing a journal during a run."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import suppress
from itertools import chain, repeat
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError, reason
from relmap.io.journal.layout import (
    APPLICATION,
    COVARIANCES,
    PAIRS,
    SCHEMA,
    Layout,
    checksum,
)

INTERVAL_S = 1.0
"""How often what was written is made sure of."""
CACHE_KIB = 16384
"""Pages that wait in memory until then: a second of the mapping makes some 3 MB."""
BLOCK = 32
"""Rows that one statement writes."""
CHECKPOINT_PAGES = 4000
"""Pages in the write-ahead log at which it is worked into the file."""


class Journal:
    """Keeps scans in an SQLite file: at the latest after a second, or at once by `flush`.

    A process may be killed at any moment: what was made sure of stays.  Where the file cannot be
    written, a full disk above all, what is not in it yet waits in memory and is tried again.

    Parameters
    ----------
    path : Path
        A journal that exists; see `create`.
    layout : Layout
    n_scans : int
        Scans in it.
    """

    def __init__(self, path: Path, layout: Layout, n_scans: int = 0) -> None:
        self.path = path
        self.n_scans = n_scans
        self._layout = layout
        self._waiting: list[tuple[str, list[tuple[Any, ...]]]] = []
        self._written = 0
        self._has_covariances = False
        self._sure_at = monotonic()
        self._failure: sqlite3.Error | None = None
        self._connection: sqlite3.Connection | None = None
        try:
            self._connection = connected(path)
            # Calls after the last scan are repeated by the program that resumes.
            self._connection.execute("DELETE FROM calls WHERE iteration >= ?", (n_scans,))
        except sqlite3.Error as error:
            raise self._error(error) from error

    @classmethod
    def create(cls, path: Path, layout: Layout, meta: dict[str, Any]) -> Journal:
        """Begin a journal.

        Raises
        ------
        RelmapError
            Where there is a file of that name, or it cannot be written.
        """
        if path.exists():
            raise RelmapError(
                f"journal {path} is there already: resume the run that it is of, or name another"
            )
        create_file(path, layout, meta)
        return cls(path, layout)

    def ready(self) -> None:
        """Make sure that there is room for more.

        Raises
        ------
        RelmapError
            Where scans taken in before could not be written, and still cannot.
        """
        if self._failure is not None:
            self.flush()

    def append(
        self,
        values: Floats,
        ids: Ints | None,
        labels: Ints,
        covariances: Floats | None = None,
        beams: bytes = b"",
    ) -> None:
        """Take in one scan; where it cannot be written, the next `ready` or `flush` says so.

        Parameters
        ----------
        values : (n, c) float64
            What was seen, in the order of the layout's columns; of points (n, 2) or (n, 3).
        ids : (n,) int64 or None
        labels : (n,) int64
        covariances : (n, d, d) float64, optional
            Of points.
        beams : bytes
            Where the layout has beams.
        """
        k, n = self.n_scans, len(labels)
        columns = values.T.tolist() if n else []
        slots = ["?"] * (2 + len(columns)) + ["NULL"] * (len(self._layout.values) - len(columns))
        if self._layout.has_ids:
            slots.append("NULL" if ids is None else "?")
            columns += [] if ids is None else [ids.tolist()]
        rows = zip(repeat(k, n), range(n), *columns, labels.tolist(), strict=True)
        self._insert(f"({', '.join(slots)}, ?)", list(chain.from_iterable(rows)), n)
        if covariances is not None and n:
            self._append_covariances(covariances)
        kept = (beams,) * self._layout.has_beams
        check = checksum(k, values, ids, labels, covariances, beams)
        scan = (k, n, int(ids is not None), check, *kept)
        slots = ["?"] * len(scan)
        self._waiting.append((f"INSERT INTO scans VALUES ({', '.join(slots)})", [scan]))
        self.n_scans += 1
        self._try(sure=monotonic() - self._sure_at >= INTERVAL_S)

    def _append_covariances(self, covariances: Floats) -> None:
        """Let the covariances (n, d, d) of a scan wait to be written, in a table of their own."""
        n, d = covariances.shape[:2]
        entries = {
            "xyz"[a] + "xyz"[b]: covariances[:, a, b].tolist()
            for a, b in zip(*np.triu_indices(d), strict=True)
        }
        columns = [entries.get(pair, [None] * n) for pair in PAIRS]
        rows = list(zip(repeat(self.n_scans, n), range(n), *columns, strict=True))
        if not self._has_covariances:
            made = COVARIANCES.replace("TABLE", "TABLE IF NOT EXISTS", 1)
            self._waiting.append((made, [()]))
            self._has_covariances = True
        slots = ", ".join("?" * (2 + len(PAIRS)))
        self._waiting.append((f"INSERT INTO covariances VALUES ({slots})", rows))

    def _insert(self, slots: str, numbers: list[float], n: int) -> None:
        """Let n rows of numbers wait to be written, many with one statement: that takes half."""
        width, end = slots.count("?"), n - n % BLOCK
        for begin, stop, k in ((0, end, BLOCK), (end, n, 1)):
            size = k * width
            rows = [tuple(numbers[i : i + size]) for i in range(begin * width, stop * width, size)]
            if rows:
                statement = f"INSERT INTO observations VALUES {', '.join([slots] * k)}"
                self._waiting.append((statement, rows))

    def call(self, name: str) -> None:
        """Note that something else was asked of the mapper, and make sure of all before it."""
        self._waiting.append(("INSERT INTO calls VALUES (?, ?)", [(self.n_scans, name)]))
        self.flush()

    def flush(self) -> None:
        """Make sure of everything taken in: whatever happens now, it is on disk.

        Raises
        ------
        RelmapError
            Where it cannot be written; it is kept in memory and tried again.
        """
        self._try(sure=True)
        if self._failure is not None:
            raise self._error(self._failure) from self._failure

    def close(self) -> None:
        """Flush, and close the file.

        Raises
        ------
        RelmapError
            As `flush` does.
        """
        if self._connection is None:
            return
        try:
            self.flush()
        finally:
            with suppress(sqlite3.Error):
                self._connection.close()
            self._connection = None

    def __del__(self) -> None:
        """Close what nobody closed."""
        with suppress(RelmapError):
            self.close()

    def _try(self, sure: bool) -> None:
        """Write what waits, and make sure of it where that is asked; note a failure."""
        try:
            self._write(sure)
            self._failure = None
        except sqlite3.Error as error:
            self._failure = error
        finally:
            if self._failure is not None or self._written < len(self._waiting):
                self._roll_back()

    def _write(self, sure: bool) -> None:
        if self._connection is None:
            raise sqlite3.ProgrammingError("it was closed")
        if not self._connection.in_transaction and self._waiting:
            self._connection.execute("BEGIN IMMEDIATE")
        for statement, rows in self._waiting[self._written :]:
            self._connection.executemany(statement, rows)
            self._written += 1
        if sure:
            if self._connection.in_transaction:
                self._connection.execute("COMMIT")
            self._waiting, self._written = [], 0
            self._sure_at = monotonic()

    def _roll_back(self) -> None:
        """Take back what was written in part; it waits in memory."""
        self._written = 0
        if self._connection is not None and self._connection.in_transaction:
            with suppress(sqlite3.Error):
                self._connection.execute("ROLLBACK")

    def _error(self, error: sqlite3.Error) -> RelmapError:
        safe = self.n_scans - sum("scans" in statement for statement, _ in self._waiting)
        return RelmapError(
            f"journal {self.path} cannot be written: {reason(error)}; the {safe} scans before are "
            "in it"
        )


def create_file(path: Path, layout: Layout, meta: dict[str, Any]) -> None:
    """Make an empty journal, whole or not at all.

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
            rows = [(key, json.dumps(value)) for key, value in meta.items()]
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
