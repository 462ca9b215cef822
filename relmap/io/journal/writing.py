"""Writing a journal during a run."""

from __future__ import annotations

import sqlite3
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from relmap.core.errors import RelmapError, reason
from relmap.io.journal.file import connected, create_file
from relmap.io.journal.layout import (
    END,
    ODOMETRY,
    STAMPS,
    End,
    Layout,
    RecordedScan,
    Statements,
    call_checksum,
    checksum,
    covariance_rows,
    observation_rows,
    rows_into,
)

if TYPE_CHECKING:
    from relmap.io.journal.reading import JournalReader

GET_END = f"SELECT value FROM meta WHERE key = '{END}'"
SET_END = f"UPDATE meta SET value = ? WHERE key = '{END}'"
INTERVAL_S = 1.0
"""Interval between durable writes."""


class Entry(NamedTuple):
    """A scan or a call waiting to be written, and the end of the journal including it."""

    statements: Statements
    end: End


class Journal:
    """Stores scans in an SQLite file: after at most a second, or at once by `flush`.

    Committed data survive if the process is killed. If the file cannot be written, for example on a
    full disk, uncommitted data are kept in memory and written later.

    `path`: an existing journal; see `create` and `go_on`.
    """

    def __init__(self, path: Path, layout: Layout, end: End) -> None:
        self.path = path
        self._layout = layout
        self._sure = end
        self._waiting: list[Entry] = []
        self._written = 0
        self._sure_at = monotonic()
        self._failure: sqlite3.Error | None = None
        self._connection: sqlite3.Connection | None = None
        try:
            self._connection = connected(path)
        except sqlite3.Error as error:
            raise self._error(error) from error

    @classmethod
    def create(cls, path: Path, layout: Layout, meta: dict[str, Any]) -> Journal:
        """Create a journal; RelmapError if the file exists, or cannot be written."""
        return cls(path, layout, create_file(path, layout, meta))

    @classmethod
    def go_on(cls, reader: JournalReader) -> Journal:
        """Continue a journal after its last scan, which a reader has read.

        Later calls are dropped: the continuing program repeats them. Raises `RelmapError` if it
        cannot be written.
        """
        journal, last = cls(reader.path, reader.layout, reader.end), reader.read
        without = "DELETE FROM calls WHERE iteration >= ?"
        journal._waiting.append(Entry([(without, [(last.scans,)])], last))
        journal.flush()
        return journal

    @property
    def n_scans(self) -> int:
        """Number of scans appended."""
        return self._end.scans

    @property
    def _end(self) -> End:
        return self._waiting[-1].end if self._waiting else self._sure

    def ready(self) -> None:
        """Check that scans can be appended; RelmapError if earlier ones still cannot be written."""
        if self._failure is not None:
            self.flush()

    def append(self, scan: RecordedScan) -> None:
        """Append one scan; if it cannot be written, the next `ready` or `flush` reports it."""
        k, n = self.n_scans, len(scan.labels)
        statements = observation_rows(self._layout, k, scan)
        if scan.covariances is not None and n:
            statements += covariance_rows(k, scan.covariances)
        if scan.odometry is not None:
            motion = np.ascontiguousarray(scan.odometry, dtype="<f8").tobytes()
            statements += rows_into(ODOMETRY, [(k, motion)])
        if scan.stamp_s is not None:
            statements += rows_into(STAMPS, [(k, scan.stamp_s)])
        check = checksum(k, scan, self._end.checksum)
        row = (k, n, int(scan.ids is not None), check, *(scan.blob,) * bool(self._layout.blob))
        slots = ", ".join("?" * len(row))
        statements.append((f"INSERT INTO scans VALUES ({slots})", [row]))
        # All of it or nothing, whenever an interrupt comes.
        self._waiting.append(Entry(statements, End(k + 1, check)))
        self._try(sure=monotonic() - self._sure_at >= INTERVAL_S)

    def call(self, name: str) -> None:
        """Record another call of the mapper, and commit everything before it.

        Raises `RelmapError` if it cannot be written; it is then not recorded.
        """
        k, check = self.n_scans, call_checksum(name, self._end.checksum)
        statement = ("INSERT INTO calls VALUES (?, ?)", [(k, name)])
        self._waiting.append(Entry([statement], End(k, check)))
        try:
            self.flush()
        except RelmapError:
            self._waiting.pop()
            raise

    def flush(self) -> None:
        """Commit everything appended to disk.

        Raises `RelmapError` if it cannot be written; it is kept in memory and tried again.
        """
        self._try(sure=True)
        if self._failure is not None:
            raise self._error(self._failure) from self._failure

    def close(self) -> None:
        """Flush, and close the file; RelmapError as for `flush`."""
        if self._connection is None:
            return
        try:
            self.flush()
        finally:
            with suppress(sqlite3.Error):
                self._connection.close()
            self._connection = None

    def __del__(self) -> None:
        """Close a journal that was not closed."""
        with suppress(RelmapError):
            self.close()

    def _try(self, sure: bool) -> None:
        """Write pending data, commit if requested, and record a failure."""
        done = False
        try:
            self._write(sure)
            self._failure, done = None, True
        except sqlite3.Error as error:
            self._failure = error
        finally:
            if not done:
                self._roll_back()

    def _write(self, sure: bool) -> None:
        connection = self._connection
        if connection is None:
            raise sqlite3.ProgrammingError("it was closed")
        if self._waiting and not connection.in_transaction:
            self._begin(connection)
        for entry in self._waiting[self._written :]:
            for statement, rows in entry.statements:
                connection.executemany(statement, rows)
            self._written += 1
        if not sure:
            return
        if connection.in_transaction:
            connection.execute(SET_END, (self._end.text,))
            connection.execute("COMMIT")
            self._sure, self._waiting, self._written = self._end, [], 0
        self._sure_at = monotonic()

    def _begin(self, connection: sqlite3.Connection) -> None:
        """Begin a transaction, after rolling back one that an interrupt left open.

        Raises `sqlite3.IntegrityError` if the end of the file is unknown to this journal.
        """
        connection.execute("BEGIN IMMEDIATE")
        (text,) = connection.execute(GET_END).fetchone() or (None,)
        ends = [self._sure, *(entry.end for entry in self._waiting)]
        there = [k for k, end in enumerate(ends) if end.text == text]
        if not there:
            raise sqlite3.IntegrityError("another program has continued it")
        self._sure, self._waiting = ends[there[-1]], self._waiting[there[-1] :]

    def _roll_back(self) -> None:
        """Roll back a partial write; its data are kept in memory."""
        self._written = 0
        if self._connection is not None and self._connection.in_transaction:
            with suppress(sqlite3.Error):
                self._connection.execute("ROLLBACK")

    def _error(self, error: sqlite3.Error) -> RelmapError:
        return RelmapError(
            f"journal {self.path} cannot be written: {reason(error)}; the {self._sure.scans} scans "
            "before are in it"
        )
