"""Reading a journal: its intact part, and the location of damage."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError, brief, reason
from relmap.io.journal.file import stated_size
from relmap.io.journal.layout import (
    APPLICATION,
    COVARIANCES,
    END,
    LAYOUTS,
    META,
    ODOMETRY,
    PAIRS,
    SCHEMA,
    STAMPS,
    End,
    Layout,
    RecordedScan,
    call_checksum,
    checksum,
    meta_checksum,
)

MOST_ROWS = 10_000_000
"""Number of observations in one scan above which the file is damaged."""
ENTRIES = f"iteration, row, {', '.join(PAIRS)}"
"""The names of the columns of covariances, as SQL lists them."""
NOWHERE = End(-1, 0)
"""End of a journal that does not state it."""
_WRONG = (sqlite3.Error, TypeError, ValueError, OverflowError, UnicodeError, RecursionError)


class JournalReader:
    """Reads a journal from the beginning.

    `meta`: see `relmap.io.journal.layout`; `calls`: calls of the mapper before each iteration;
    `end`: its end, as stated; `read`: end of the last scan yielded by `scans`. Raises `RelmapError`
    if it is not a journal, is of another version, or nothing can be recovered.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not os.path.isfile(path):
            raise RelmapError(f"there is no journal {path}")
        try:
            self._connection = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=rw", uri=True, isolation_level=None
            )
        except sqlite3.Error as error:
            raise RelmapError(f"journal {path} cannot be opened: {reason(error)}") from error
        try:
            self._check_version()
            # Everything is read as of now, even while another process writes.
            self._connection.execute("BEGIN")
            self._require({"meta": META})
            self.meta, self.end, begin = self._read_meta()
            self.read = self._before = End(0, begin)
            self.layout: Layout = LAYOUTS[self.meta["variant"]]
            self._require(self.layout.tables)
            more = {"covariances": COVARIANCES, "odometry": ODOMETRY, "stamps": STAMPS}
            there = {name for (name,) in self._connection.execute("SELECT name FROM sqlite_master")}
            self._more = {name: sql for name, sql in more.items() if name in there}
            self._require(self._more)
            self.calls = self._read_calls()
        except _WRONG as error:
            self.close()
            size, whole = path.stat().st_size, stated_size(path)
            if size < whole:
                raise RelmapError(
                    f"journal {path} is truncated, {size} of {whole} bytes: its beginning can be "
                    "recovered by relmap resume --salvage if its header is undamaged"
                ) from error
            raise RelmapError(
                f"{path} is not a journal, or its header is damaged, so that nothing of it can be "
                f"recovered: {reason(error)}"
            ) from error
        except RelmapError:
            self.close()
            raise

    def __enter__(self) -> JournalReader:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def scans(self) -> Iterator[RecordedScan]:
        """Yield every scan in order; RelmapError at the first damage."""
        self.read = self._before
        try:
            scans = self._rows(self.layout.scans, "scans", "iteration")
            rows = self._rows(self.layout.names, "observations")
            covariances = (
                self._rows(ENTRIES, "covariances") if "covariances" in self._more else None
            )
            motions = self._by_scan("odometry", "motion")
            stamps_s = self._by_scan("stamps", "stamp")
            for k, (iteration, n, known, check, *blob) in enumerate(scans):
                if iteration != k:
                    raise ValueError("a scan is missing")
                scan = self._scan(rows, k, n, known, blob)
                if covariances is not None and n:
                    scan = replace(scan, covariances=_matrices(covariances, k, *scan.values.shape))
                if k in motions:
                    motions[k] = np.frombuffer(motions[k], dtype="<f8").reshape(4, 4)
                scan = replace(scan, odometry=motions.pop(k, None), stamp_s=stamps_s.pop(k, None))
                if check != checksum(k, scan, self._called(k)):
                    raise ValueError("its checksum does not match")
                self.read = End(k + 1, check)
                yield scan
            left = motions or stamps_s or (covariances is not None and covariances.fetchone())
            if rows.fetchone() or left:
                raise ValueError("there are observations without a scan")
            last = self.read.scans
            if self.end != End(last, self._called(last)) or max(self.calls, default=0) > last:
                raise ValueError(f"it should end there, after {self.end.scans} scans")
        except _WRONG as error:
            k = self.read.scans
            some = f"the {k} scans before can be recovered: relmap resume --salvage does it"
            raise RelmapError(
                f"journal {self.path} is damaged at iteration {k}: {reason(error)}; "
                f"{some if k else 'nothing of it can be recovered: map its log again'}"
            ) from error

    def _called(self, k: int) -> int:
        """Return the checksum including the calls after the last scan read."""
        check = self.read.checksum
        for call in self.calls.get(k, []):
            check = call_checksum(call, check)
        return check

    def _rows(self, columns: str, table: str, order: str = "rowid") -> sqlite3.Cursor:
        return self._connection.execute(f"SELECT {columns} FROM {table} ORDER BY {order}")

    def _by_scan(self, table: str, column: str) -> dict[int, Any]:
        """Return the value in a table, if there is such a one, of each scan that has it."""
        return dict(self._rows(f"iteration, {column}", table)) if table in self._more else {}

    def _scan(
        self, cursor: sqlite3.Cursor, k: int, n: int, known: int, blob: list[bytes]
    ) -> RecordedScan:
        """Return scan k, whose observations are next; check that unused fields are empty."""
        if not 0 <= n <= MOST_ROWS or known not in (0, int(self.layout.has_ids)):
            raise ValueError(f"a scan of {brief(n)} rows, with ids: {brief(known)}")
        if any(type(part) is not bytes for part in blob):
            raise ValueError(f"its {self.layout.blob} are not bytes")
        rows = _next(cursor, k, n, "observations")
        has_ids, width = self.layout.has_ids, len(self.layout.values)
        labels = _whole([row[-1] for row in rows])
        if has_ids and any((row[-2] is None) == bool(known) for row in rows):
            raise ValueError("ids are missing, or too many")
        planar = has_ids and n and rows[0][width - 1] is None
        if planar and any(row[width - 1] is not None for row in rows):
            raise ValueError("a planar scan has a height")
        values = np.array([row[: width - bool(planar)] for row in rows], dtype=np.float64)
        of = _whole([row[-2] for row in rows]) if has_ids and known else None
        return RecordedScan(values.reshape(n, -1 if n else width), of, labels, blob=b"".join(blob))

    def _check_version(self) -> None:
        (application,) = self._connection.execute("PRAGMA application_id").fetchone()
        (version,) = self._connection.execute("PRAGMA user_version").fetchone()
        if application != APPLICATION:
            raise RelmapError(f"{self.path} is an SQLite file, but not a journal of relmap")
        if version != SCHEMA:
            advice = "a newer relmap can resume it" if version > SCHEMA else "map its log again"
            raise RelmapError(
                f"journal {self.path} is of version {version}, and this relmap reads {SCHEMA}: "
                f"{advice}"
            )
        self._connection.execute("PRAGMA trusted_schema = OFF")

    def _read_meta(self) -> tuple[dict[str, Any], End, int]:
        """Return the metadata of the journal, its end, and the checksum of the metadata."""
        rows = self._connection.execute("SELECT key, value FROM meta").fetchall()
        meta = {key: json.loads(value) for key, value in rows}
        if not isinstance(meta.get("configuration"), dict) or meta.get("variant") not in LAYOUTS:
            raise ValueError("its table meta lacks variant or configuration")
        end = meta.pop(END, None)
        whole = isinstance(end, dict) and end.keys() == {"scans", "checksum"}
        return meta, End(**end) if whole else NOWHERE, meta_checksum(rows)

    def _require(self, tables: dict[str, str]) -> None:
        """Check that tables are as expected, without triggers or views."""
        found = self._connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
        made = {name: sql for kind, name, sql in found if kind == "table"}
        for name, sql in tables.items():
            if made.get(name) != sql:
                raise ValueError(f"its table {name} has an unexpected definition")
        if any(kind == "trigger" for kind, _, _ in found):
            raise ValueError("it has a trigger")

    def _read_calls(self) -> dict[int, list[str]]:
        """Return the calls of the mapper before each iteration."""
        calls: dict[int, list[str]] = {}
        for iteration, call in self._rows("iteration, call", "calls"):
            if call not in ("finish", "refine") or type(iteration) is not int:
                raise ValueError(f"its table calls holds {brief(call)} at {brief(iteration)}")
            calls.setdefault(iteration, []).append(call)
        return calls


def _next(cursor: sqlite3.Cursor, k: int, n: int, what: str) -> list[tuple[Any, ...]]:
    """Return the next n rows of scan k, without iteration and row numbers."""
    rows = cursor.fetchmany(n) if n else []
    if len(rows) != n or [row[:2] for row in rows] != [(k, i) for i in range(n)]:
        raise ValueError(f"{what} are missing")
    return [row[2:] for row in rows]


def _whole(numbers: list[Any]) -> Ints:
    found = np.array(numbers)
    if len(found) and found.dtype != np.int64:
        raise ValueError(f"{found.dtype} where whole numbers should be")
    return found.astype(np.int64)


def _matrices(cursor: sqlite3.Cursor, k: int, n: int, d: int) -> Floats:
    """Return the covariances (n, d, d) of scan k, which are next."""
    rows = np.array(_next(cursor, k, n, "covariances"), dtype=np.float64)
    entries = dict(zip(PAIRS, rows.T, strict=True))
    found = np.empty((n, d, d))
    for a, b in zip(*np.triu_indices(d), strict=True):
        found[:, a, b] = found[:, b, a] = entries.pop("xyz"[a] + "xyz"[b])
    if not np.isnan(list(entries.values())).all():
        raise ValueError("covariances of a planar scan have a height")
    return found
