"""Reading a journal: what is whole in it, and where it is damaged."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError, reason
from relmap.io.journal.layout import (
    APPLICATION,
    COVARIANCES,
    LAYOUTS,
    META,
    PAIRS,
    SCHEMA,
    Layout,
    checksum,
)

MOST_ROWS = 10_000_000
"""Observations in one scan above which the number is damage."""
_WRONG = (sqlite3.Error, TypeError, ValueError, OverflowError, UnicodeError, RecursionError)


@dataclass(frozen=True, eq=False)
class RecordedScan:
    """One scan, as the mapper took it in.

    Attributes
    ----------
    values : (n, c) float64
        In the order of the layout's columns; of points (n, 2) in a planar world.
    ids : (n,) int64 or None
    labels : (n,) int64
        What the mapper called the landmarks.
    covariances : (n, d, d) float64 or None
        Of points, where they came; None for a scan without observations.
    beams : bytes
    """

    values: Floats
    ids: Ints | None
    labels: Ints
    covariances: Floats | None = None
    beams: bytes = b""


class JournalReader:
    """Reads a journal from the beginning.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    layout : Layout
    meta : dict
        See `relmap.io.journal.layout`.

    Raises
    ------
    RelmapError
        Where it is not a journal, or one of a newer relmap, or nothing of it can be recovered.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise RelmapError(f"there is no journal {path}")
        try:
            self._connection = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=rw", uri=True, isolation_level=None
            )
        except sqlite3.Error as error:
            raise RelmapError(f"journal {path} cannot be opened: {reason(error)}") from error
        try:
            self._check_version()
            self._require({"meta": META})
            self.meta = self._read_meta()
            self.layout: Layout = LAYOUTS[self.meta["variant"]]
            if self.layout.has_beams and self._version < SCHEMA:
                raise RelmapError(
                    f"journal {path} is of version {self._version}, which kept no beams: map its "
                    "log again"
                )
            self._require(self.layout.tables)
            self._has_covariances = self._holds("covariances")
            if self._has_covariances:
                self._require({"covariances": COVARIANCES})
            self.calls = self._read_calls()
        except _WRONG as error:
            self.close()
            size, whole = path.stat().st_size, stated_size(path)
            if size < whole:
                raise RelmapError(
                    f"journal {path} is cut short, {size} of {whole} bytes: what is left can be "
                    "recovered: relmap resume --salvage does it"
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
        """Yield every scan, the first first.

        Raises
        ------
        RelmapError
            Where the journal is damaged; all scans before that were yielded.
        """
        k = -1
        try:
            scans = self._connection.execute(
                f"SELECT {self.layout.scans} FROM scans ORDER BY iteration"
            )
            rows = self._connection.execute(
                f"SELECT {self.layout.names} FROM observations ORDER BY rowid"
            )
            covariances = self._covariances()
            for k, (iteration, n, known, check, *beams) in enumerate(scans):
                scan = replace(self._scan(rows, k, n, bool(known)), beams=bytes(*beams))
                if covariances is not None and n:
                    scan = replace(scan, covariances=_matrices(covariances, k, *scan.values.shape))
                if iteration != k or check != checksum(k, **vars(scan)):
                    raise ValueError("its checksum does not match")
                yield scan
                k += 1
            if rows.fetchone() is not None:
                raise ValueError("there are observations without a scan")
        except _WRONG as error:
            k = max(k, 0)
            raise RelmapError(
                f"journal {self.path} is damaged at iteration {k}: {reason(error)}; the {k} scans "
                "before can be recovered: relmap resume --salvage does it"
            ) from error

    def _covariances(self) -> sqlite3.Cursor | None:
        """Return a cursor at the first covariance; None where none came."""
        if not self._has_covariances:
            return None
        names = ", ".join(("iteration", "row", *PAIRS))
        return self._connection.execute(f"SELECT {names} FROM covariances ORDER BY rowid")

    def _scan(self, cursor: sqlite3.Cursor, k: int, n: int, known: bool) -> RecordedScan:
        if not 0 <= n <= MOST_ROWS:
            raise ValueError(f"a scan of {n} rows")
        rows = cursor.fetchmany(n) if n else []
        if [row[:2] for row in rows] != [(k, i) for i in range(n)]:
            raise ValueError("observations are missing")
        ids = self.layout.has_ids
        columns = list(zip(*rows, strict=True))[2:] if n else []
        labels = np.array(columns[-1] if n else [], dtype=np.int64)
        seen = np.array(columns[: len(self.layout.values)], dtype=np.float64)
        values = np.ascontiguousarray(seen.T).reshape(n, len(self.layout.values))
        if ids and n and columns[2][0] is None:
            values = np.ascontiguousarray(values[:, :2])
        of = np.array(columns[-2] if n else [], dtype=np.int64) if ids and known else None
        return RecordedScan(values, of, labels)

    def _check_version(self) -> None:
        (application,) = self._connection.execute("PRAGMA application_id").fetchone()
        (self._version,) = self._connection.execute("PRAGMA user_version").fetchone()
        if application != APPLICATION:
            raise RelmapError(f"{self.path} is an SQLite file, but not a journal of relmap")
        if self._version > SCHEMA:
            raise RelmapError(
                f"journal {self.path} is of version {self._version}, and this relmap reads up to "
                f"{SCHEMA}: a newer relmap can resume it"
            )
        self._connection.execute("PRAGMA trusted_schema = OFF")

    def _read_meta(self) -> dict[str, Any]:
        meta = {
            key: json.loads(value)
            for key, value in self._connection.execute("SELECT key, value FROM meta")
        }
        if not isinstance(meta.get("configuration"), dict) or meta.get("variant") not in LAYOUTS:
            raise ValueError("its table meta lacks variant or configuration")
        return meta

    def _holds(self, table: str) -> bool:
        sql = "SELECT count(*) FROM sqlite_master WHERE name = ?"
        return bool(self._connection.execute(sql, (table,)).fetchone()[0])

    def _require(self, tables: dict[str, str]) -> None:
        """Make sure that tables are just what they should be: nothing hides behind their names."""
        found = self._connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
        made = {name: sql for kind, name, sql in found if kind == "table"}
        for name, sql in tables.items():
            if made.get(name) != sql:
                raise ValueError(f"its table {name} is not as it should be")
        if any(kind == "trigger" for kind, _, _ in found):
            raise ValueError("it has a trigger")

    def _read_calls(self) -> dict[int, list[str]]:
        """Return what was asked of the mapper before each iteration."""
        calls: dict[int, list[str]] = {}
        for iteration, call in self._connection.execute(
            "SELECT iteration, call FROM calls ORDER BY rowid"
        ):
            if call not in ("finish", "refine"):
                raise ValueError(f"its table calls holds {call!r}")
            calls.setdefault(int(iteration), []).append(call)
        return calls


def _matrices(cursor: sqlite3.Cursor, k: int, n: int, d: int) -> Floats:
    """Return the covariances (n, d, d) of scan k, which are next."""
    rows = cursor.fetchmany(n)
    if [row[:2] for row in rows] != [(k, i) for i in range(n)]:
        raise ValueError("covariances are missing")
    entries = np.array([row[2:] for row in rows], dtype=np.float64)
    found = np.empty((n, d, d))
    for a, b in zip(*np.triu_indices(d), strict=True):
        found[:, a, b] = found[:, b, a] = entries[:, PAIRS.index("xyz"[a] + "xyz"[b])]
    return found


def stated_size(path: Path) -> int:
    """Return the bytes that an SQLite file should have by what it says; 0 where it says nothing."""
    with path.open("rb") as stream:
        head = stream.read(100)
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0"):
        return 0
    page = int.from_bytes(head[16:18], "big")
    return (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
