"""What a journal holds: its tables and their meaning, for points and for planes.

``PRAGMA application_id`` marks a journal among SQLite files, ``PRAGMA user_version`` is the
version of what follows.

``meta``
    ``key`` and ``value``, a text in JSON: ``variant`` ("points" or "planes"), ``configuration`` of
    the mapper, ``versions`` of relmap and what it is built on, and ``run``: what the command line
    was asked for, null where a program of its own keeps the journal.  ``end`` tells how many
    ``scans`` there are, and the ``checksum`` at the end; it changes with each transaction.
``scans``
    One row for each update: ``iteration`` from 0, ``rows`` in ``observations``, ``known`` (1 where
    ids came with it), ``checksum``; of planes ``beams``, see `relmap.planes.beams`, in bytes.
``observations``
    One row for each observation in the order of ``iteration`` and ``row``, as given to the mapper.
    Of points ``x``, ``y``, ``z`` in the robot frame, metres, ``z`` null in a planar world, ``id``
    null where none came, and ``landmark``, the label that the mapper gave it.
    Of planes the right end ``x0``, ``y0`` and the left end ``x1``, ``y1``, robot frame, metres, the
    extent ``z0``, ``z1``, ``sd`` of the wall's distance, ``end0`` and ``end1`` (1 for a corner,
    else 0), and ``landmark``, the number of the wall.
``covariances``
    Only where covariances came with points: ``iteration``, ``row``, and ``xx``, ``xy``, ``xz``,
    ``yy``, ``yz``, ``zz``, robot frame, square metres, those of z null in a planar world.
``odometry``
    Only where odometry came: ``iteration``, and ``motion``, the pose of the robot in its frame one
    iteration before, a 4 by 4 matrix row by row, 16 little-endian numbers of 8 bytes.
``calls``
    What else was asked of the mapper, "finish" or "refine", when it had taken in the scans before
    ``iteration``.

A checksum is the CRC-32 of everything from the beginning, in the order in which it came: of
``meta`` (see `meta_checksum`), and of each scan and call that followed (see `checksum`).  So
no accidental change, loss, addition or reordering goes unnoticed.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np

from relmap.core.arrays import Floats, Ints

SCHEMA = 3
"""Version of the tables; since 3 each checksum is of everything before it."""
APPLICATION = 0x726C6D70
"""What SQLite's ``application_id`` says: relmap."""
END = "end"
"""The key of ``meta`` that marks the end of the journal."""
META = "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT)"
PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
"""The entries of a covariance: those of its upper triangle."""
COVARIANCES = (
    f"CREATE TABLE covariances (iteration INTEGER, row INTEGER, {' REAL, '.join(PAIRS)} REAL)"
)

ODOMETRY = "CREATE TABLE odometry (iteration INTEGER PRIMARY KEY, motion BLOB)"


@dataclass(frozen=True)
class Layout:
    """The columns of the observations of one variant.

    Attributes
    ----------
    variant : str
    values : tuple of str
        The columns of what was seen, with their types.
    has_ids : bool
        Whether ids may come with what was seen.
    has_beams : bool
        Whether beams may come with it.
    """

    variant: str
    values: tuple[str, ...]
    has_ids: bool
    has_beams: bool

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
        return "iteration, rows, known, checksum" + ", beams" * self.has_beams

    @property
    def tables(self) -> dict[str, str]:
        """The SQL that makes each table."""
        beams = ", beams BLOB" * self.has_beams
        return {
            "meta": META,
            "scans": "CREATE TABLE scans (iteration INTEGER PRIMARY KEY, rows INTEGER, "
            f"known INTEGER, checksum INTEGER{beams})",
            "observations": f"CREATE TABLE observations ({', '.join(self.columns)})",
            "calls": "CREATE TABLE calls (iteration INTEGER, call TEXT)",
        }


POINTS = Layout("points", ("x REAL", "y REAL", "z REAL"), has_ids=True, has_beams=False)
_WALL = [f"{name} REAL" for name in ("x0", "y0", "x1", "y1", "z0", "z1", "sd")]
PLANES = Layout("planes", (*_WALL, "end0 INTEGER", "end1 INTEGER"), has_ids=False, has_beams=True)
LAYOUTS = {layout.variant: layout for layout in (POINTS, PLANES)}


@dataclass(frozen=True)
class End:
    """Where a journal ends.

    Attributes
    ----------
    scans : int
        How many it holds.
    checksum : int
        Of everything in it.
    """

    scans: int
    checksum: int

    @property
    def text(self) -> str:
        """What ``meta`` holds of it."""
        return json.dumps(asdict(self))


def meta_checksum(rows: Iterable[tuple[str, str]]) -> int:
    """Return the CRC-32 of keys and values of ``meta``, by key, each with a zero byte behind it."""
    told = (text for row in sorted(rows) if row[0] != END for text in row)
    return zlib.crc32("".join(f"{text}\0" for text in told).encode())


def call_checksum(name: str, before: int) -> int:
    """Return the CRC-32 with a call, after that of everything before."""
    return zlib.crc32(name.encode(), before)


def checksum(
    iteration: int,
    values: Floats,
    ids: Ints | None,
    labels: Ints,
    covariances: Floats | None = None,
    beams: bytes = b"",
    odometry: Floats | None = None,
    before: int = 0,
) -> int:
    """Return the CRC-32 with a scan, after that of everything before.

    It is that of the iteration number, n, n c, and 1 or 0 for whether ids came, the values (n, c)
    row by row, the ids where they came, the landmarks (n,), and where they came the covariances
    (n, d, d) row by row, and the odometry (4, 4); all as little-endian numbers of 8 bytes; and of
    the beams.
    """
    head = struct.pack("<4q", iteration, len(labels), values.size, ids is not None)
    came = [part for part in (ids, labels, covariances, odometry) if part is not None]
    total = zlib.crc32(head, before)
    for part in (values, *came):
        kind = "<f8" if part.dtype.kind == "f" else "<i8"
        total = zlib.crc32(np.ascontiguousarray(part, dtype=kind).tobytes(), total)
    return zlib.crc32(beams, total)
