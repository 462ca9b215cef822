"""The tables of a journal, for each variant, and the statements that write a scan.

``PRAGMA application_id`` marks a journal among SQLite files, ``PRAGMA user_version`` is the version
of the tables.

``meta``
    ``key`` and ``value``, a text in JSON: ``variant`` ("points", "planes" or "planes3d"),
    ``configuration`` of the mapper, ``versions`` of relmap and of its dependencies, and ``run``:
    the arguments of the command line, null if a library user keeps the journal. ``end`` has the
    number of ``scans`` and the ``checksum`` at the end; it changes with each transaction.
``scans``
    One row per update: ``iteration`` from 0, ``rows`` in ``observations``, ``known`` (1 if it has
    ids), ``checksum``; and in bytes, of planes ``beams``, see `relmap.planes.scans.beams`, and of
    planes3d ``cells``, see `relmap.planes3d.files`.
``observations``
    One row per observation in the order of ``iteration`` and ``row``, as given to the mapper. For
    points ``x``, ``y``, ``z`` in the robot frame, metres, ``z`` null in a planar world, ``id`` null
    without one, and ``landmark``, the label assigned by the mapper. For planes the right end
    ``x0``, ``y0`` and the left end ``x1``, ``y1``, robot frame, metres, the extent ``z0``, ``z1``,
    ``sd`` of the wall's distance, ``end0`` and ``end1`` (1 for a corner, else 0), and ``landmark``,
    the number of the wall. For planes3d the centre ``x``, ``y``, ``z``, the axes ``ux`` to ``nz``
    with ``information_u`` and ``spread_u`` to ``spread_n`` along them, and ``points``, as in
    `relmap.segmentation.space.Patches`, and ``landmark``.
``covariances``
    Only if points have covariances: ``iteration``, ``row``, and ``xx``, ``xy``, ``xz``, ``yy``,
    ``yz``, ``zz``, robot frame, square metres, those of z null in a planar world.
``odometry``
    Only with odometry: ``iteration``, and ``motion``, the pose of the robot in its frame one
    iteration before, a 4 by 4 matrix row by row, 16 little-endian numbers of 8 bytes.
``stamps``
    Only with times: ``iteration``, and ``stamp``, seconds.
``calls``
    Other calls of the mapper, "finish" or "refine", made after the scans before ``iteration``.

A checksum is the CRC-32 of everything from the beginning, in the order in which it came: of
``meta`` (see `meta_checksum`), and of each scan and call that followed (see `checksum`).  So any
accidental change, loss, addition or reordering is detected.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from itertools import chain, repeat
from typing import Any

import numpy as np

from relmap.core.arrays import Floats, Ints

SCHEMA = 3
"""Version of the tables; since 3 each checksum covers everything before it."""
APPLICATION = 0x726C6D70
"""SQLite's ``application_id`` of relmap."""
END = "end"
"""The key of ``meta`` that marks the end of the journal."""
META = "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT)"
PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
"""The entries of a covariance: its upper triangle."""
COVARIANCES = (
    f"CREATE TABLE covariances (iteration INTEGER, row INTEGER, {' REAL, '.join(PAIRS)} REAL)"
)

ODOMETRY = "CREATE TABLE odometry (iteration INTEGER PRIMARY KEY, motion BLOB)"
STAMPS = "CREATE TABLE stamps (iteration INTEGER PRIMARY KEY, stamp REAL)"
Statements = list[tuple[str, list[tuple[Any, ...]]]]
"""SQL, and the rows of values to execute it with."""
BLOCK = 32
"""Rows written by one statement."""


@dataclass(frozen=True)
class Layout:
    """The columns of the observations of one variant.

    `values`: the columns of the observations, with their types; `has_ids`: whether observations may
    have ids; `blob`: name of what else a scan has, in bytes; empty if nothing.
    """

    variant: str
    values: tuple[str, ...]
    has_ids: bool
    blob: str = ""

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns of the observations, with their types."""
        ids = ("id INTEGER",) if self.has_ids else ()
        return ("iteration INTEGER", "row INTEGER", *self.values, *ids, "landmark INTEGER")

    @property
    def names(self) -> str:
        """The names of all columns, as SQL lists them."""
        return ", ".join(column.split()[0] for column in self.columns)

    @property
    def scans(self) -> str:
        """The names of the columns of scans, as SQL lists them."""
        return "iteration, rows, known, checksum" + (self.blob and f", {self.blob}")

    @property
    def tables(self) -> dict[str, str]:
        """The SQL statements that create the tables."""
        blob = self.blob and f", {self.blob} BLOB"
        return {
            "meta": META,
            "scans": "CREATE TABLE scans (iteration INTEGER PRIMARY KEY, rows INTEGER, "
            f"known INTEGER, checksum INTEGER{blob})",
            "observations": f"CREATE TABLE observations ({', '.join(self.columns)})",
            "calls": "CREATE TABLE calls (iteration INTEGER, call TEXT)",
        }


POINTS = Layout("points", ("x REAL", "y REAL", "z REAL"), has_ids=True)
_WALL = [f"{name} REAL" for name in ("x0", "y0", "x1", "y1", "z0", "z1", "sd")]
PLANES = Layout("planes", (*_WALL, "end0 INTEGER", "end1 INTEGER"), has_ids=False, blob="beams")
_PATCH = ["x", "y", "z", *(f"{axis}{of}" for axis in "uvn" for of in "xyz")]
_PATCH += [f"{what}_{axis}" for what in ("information", "spread") for axis in "uvn"]
_PATCH_VALUES = (*(f"{name} REAL" for name in _PATCH), "points INTEGER")
PLANES3D = Layout("planes3d", _PATCH_VALUES, has_ids=False, blob="cells")
LAYOUTS = {layout.variant: layout for layout in (POINTS, PLANES, PLANES3D)}


@dataclass(frozen=True, eq=False)
class RecordedScan:
    """One scan, as given to the mapper.

    `values` (n, c): in the order of the layout's columns; for points (n, 2) in a planar world.
    `ids` (n,); `labels` (n,): labels assigned by the mapper. `covariances` (n, d, d): for points,
    if given; None for a scan without observations. `odometry` (4, 4): motion of the robot since the
    previous scan, if given. `stamp_s`: its time, seconds, if given.
    """

    values: Floats
    ids: Ints | None
    labels: Ints
    covariances: Floats | None = None
    blob: bytes = b""
    odometry: Floats | None = None
    stamp_s: float | None = None


@dataclass(frozen=True)
class End:
    """The end of a journal: its number of scans, and the checksum of its whole content."""

    scans: int
    checksum: int

    @property
    def text(self) -> str:
        """Its representation in ``meta``."""
        return json.dumps(asdict(self))


def meta_checksum(rows: Iterable[tuple[str, str]]) -> int:
    """Return the CRC-32 of the sorted keys and values of ``meta``, each followed by a zero."""
    texts = (text for row in sorted(rows) if row[0] != END for text in row)
    return zlib.crc32("".join(f"{text}\0" for text in texts).encode())


def call_checksum(name: str, before: int) -> int:
    """Return the CRC-32 continued with a call."""
    return zlib.crc32(name.encode(), before)


def checksum(iteration: int, scan: RecordedScan, before: int) -> int:
    """Return the CRC-32 continued with a scan.

    It covers the iteration number, n, n c, and 1 or 0 for the presence of ids, the values (n, c)
    row by row, the ids if any, the landmarks (n,), the covariances (n, d, d) row by row, the
    odometry (4, 4) and the time if any; all as little-endian numbers of 8 bytes; and the blob.
    """
    numbers = (iteration, len(scan.labels), scan.values.size, scan.ids is not None)
    time_s = None if scan.stamp_s is None else np.array([scan.stamp_s])
    parts = (scan.values, scan.ids, scan.labels, scan.covariances, scan.odometry, time_s)
    total = zlib.crc32(struct.pack("<4q", *numbers), before)
    for part in (part for part in parts if part is not None):
        kind = "<f8" if part.dtype.kind == "f" else "<i8"
        total = zlib.crc32(np.ascontiguousarray(part, dtype=kind).tobytes(), total)
    return zlib.crc32(scan.blob, total)


def observation_rows(layout: Layout, k: int, scan: RecordedScan) -> Statements:
    """Return the statements that write the observations of scan k."""
    n, ids = len(scan.labels), scan.ids
    columns = scan.values.T.tolist() if n else []
    slots = ["?"] * (2 + len(columns)) + ["NULL"] * (len(layout.values) - len(columns))
    if layout.has_ids:
        slots.append("NULL" if ids is None else "?")
        columns += [] if ids is None else [ids.tolist()]
    rows = zip(repeat(k, n), range(n), *columns, scan.labels.tolist(), strict=True)
    slot, numbers = f"({', '.join(slots)}, ?)", list(chain.from_iterable(rows))
    statements: Statements = []
    width, end = slot.count("?"), n - n % BLOCK
    for begin, stop, count in ((0, end, BLOCK), (end, n, 1)):
        size = count * width
        each = [tuple(numbers[i : i + size]) for i in range(begin * width, stop * width, size)]
        if each:
            values_of = ", ".join([slot] * count)
            statements.append((f"INSERT INTO observations VALUES {values_of}", each))
    return statements


def covariance_rows(k: int, covariances: Floats) -> Statements:
    """Return the statements that write the covariances (n, d, d) of scan k into their table."""
    n, d = covariances.shape[:2]
    entries = {
        "xyz"[a] + "xyz"[b]: covariances[:, a, b].tolist()
        for a, b in zip(*np.triu_indices(d), strict=True)
    }
    columns = [entries.get(pair, [None] * n) for pair in PAIRS]
    return rows_into(COVARIANCES, list(zip(repeat(k, n), range(n), *columns, strict=True)))


def rows_into(table: str, rows: list[tuple[Any, ...]]) -> Statements:
    """Return the statements that write rows into a table, given by its SQL, and make it first."""
    made = table.replace("TABLE", "TABLE IF NOT EXISTS", 1)
    slots = ", ".join("?" * len(rows[0]))
    return [(made, [()]), (f"INSERT INTO {table.split()[2]} VALUES ({slots})", rows)]
