"""The project's own observation log: ``observations.csv``, plain or gzipped.

Header ``iteration,x,y[,z][,id][,stamp]`` in any order, rows in any order; robot frame, metres;
``id`` is a known association, negative or empty if there is none; ``stamp`` is the time of the
iteration, seconds. Without ``z`` the world is planar. Columns are separated by commas, semicolons
or tabs; cells may be in double quotes. Instead of ``x,y,z`` there may be
``range,bearing[,elevation]``, metres and radians, positive to the left and upwards.
``cxx,cxy,cyy``, and in space also ``cxz,cyz,czz``, are the covariance of the position in ``x,y,z``,
robot frame, square metres: all of them or none.
"""

from __future__ import annotations

import gzip
import math
import os
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.scan import checked_covariances
from relmap.datasets.assembly import (
    MAX_COORDINATE_M,
    assemble_log,
    from_polar,
    id_column,
    iteration_column,
    metres_column,
    with_stamps,
)
from relmap.datasets.base import ObservationLog
from relmap.datasets.headers import columns_of, only_one
from relmap.datasets.table import Column, Table, header_text, read_table
from relmap.datasets.textfile import invalid, replacing

FILE_NAMES = ("observations.csv", "observations.csv.gz")
"""The log's name in a folder."""

_PAIRS = ("xx", "xy", "yy", "xz", "yz", "zz")
_OTHERS = (
    replace(id_column("id", required=False), advice="texts: --columns id=id"),
    Column("stamp", -1e12, 1e12, "seconds", required=False),
    *(Column(f"c{pair}", -1e18, 1e18, "square metres", required=False) for pair in _PAIRS),
)
COLUMNS = (
    iteration_column("iteration"),
    metres_column("x"),
    metres_column("y"),
    metres_column("z", required=False),
    *_OTHERS,
)
"""Columns of an observation log."""
POLAR_COLUMNS = (
    iteration_column("iteration"),
    Column("range", 0.0, MAX_COORDINATE_M, "metres"),
    Column("bearing", -math.tau, math.tau, "radians"),
    Column("elevation", -math.pi / 2, math.pi / 2, "radians", required=False),
    *_OTHERS,
)
"""The same with ranges and bearings."""

CARTESIAN = ("x", "y", "z")
POLAR = ("range", "bearing", "elevation")

_GZIP_LEVEL = 4
_ROWS_AT_ONCE = 50_000

OTHER_NAMES = (
    "for columns of other names, --columns iteration=...,x=...,y=... (stamp=... for times; "
    "range=...,bearing=... instead of x, y)"
)
"""Advice for a table with another header."""


class ObservationCsv:
    """Reads ``observations.csv``, or a folder that contains it."""

    name = "observation-csv"
    description = f"observations.csv with the header {header_text(COLUMNS)}"

    def recognises(self, path: Path) -> bool:
        """Return whether the header is that of an observation log, or almost.

        A header with a missing or misspelt column is recognised too, so that the reader can report
        the error.
        """
        if os.path.isdir(path):
            return any("range_m" not in columns_of(member) for member in _members(path))
        found = columns_of(path)
        if any("iteration" in column.lower() for column in found):
            return True
        return len(found & {column.name for column in (*COLUMNS, *POLAR_COLUMNS)}) >= 2

    def load(self, path: Path) -> ObservationLog:
        """Read the log."""
        file = only_one(path, _members(path), "observation log", " or ".join(FILE_NAMES))
        found = columns_of(file)
        if found >= {"x", "y", "range", "bearing"}:
            problem = "columns x, y and also range, bearing, expected either of them"
            raise invalid(file, f"{problem}; --columns x=x,y=y ignores the others")
        columns = POLAR_COLUMNS if is_polar(found) else COLUMNS
        whole = found >= {column.name for column in columns if column.required}
        advice = f"--columns {columns[1].name}={columns[1].name} ignores the others"
        return log_of_table(read_table(file, columns, f"; {advice if whole else OTHER_NAMES}"))


def is_polar(names: Collection[str]) -> bool:
    """Return whether the names of columns are rather ``range,bearing`` than ``x,y``."""
    return sum(name in names for name in POLAR[:2]) > sum(name in names for name in CARTESIAN[:2])


def log_of_table(table: Table) -> ObservationLog:
    """Return the log in a table with some of `COLUMNS` or `POLAR_COLUMNS`.

    RelmapError as for `assemble_log`.
    """
    ids = table.integers("id") if "id" in table.columns else None
    if "range" in table.columns:
        polar = [table.columns[name] for name in POLAR if name in table.columns]
        points = from_polar(*polar)
    else:
        points = np.column_stack([table.columns[axis] for axis in "xyz" if axis in table.columns])
    log = assemble_log(table, "iteration", points, ids, _covariances_of(table, points))
    return with_stamps(table, log) if "stamp" in table.columns else log


def _covariances_of(table: Table, points: Floats) -> Floats | None:
    """Return the covariances (n, d, d) of points (n, d); None without covariance columns."""
    d = points.shape[1]
    wanted = [f"c{pair}" for pair in _PAIRS if d == 3 or "z" not in pair]
    found = [name for name in table.columns if name[1:] in _PAIRS]
    if not found:
        return None
    if sorted(found) != sorted(wanted):
        problem = f"covariances need the columns {', '.join(wanted)}"
        raise invalid(table.path, f"{problem}, and there are {', '.join(found)}")
    covariances = np.empty((len(points), d, d))
    for name in wanted:
        a, b = ("xyz".index(axis) for axis in name[1:])
        covariances[:, a, b] = covariances[:, b, a] = table.columns[name]
    try:
        return checked_covariances(covariances, points, table.place, table.lines)
    except RelmapError as error:
        raise invalid(table.path, str(error)) from error


def write_observation_csv(path: Path | str, log: ObservationLog) -> None:
    """Write a log so that reading it gives the same numbers, bit by bit.

    Rows are written in the log's order; iterations without a row leave no trace in the file, so
    empty ones at either end are lost. The same log gives the same bytes.

    `path`: the file, gzipped if its name ends in ``.gz``; written atomically. `log`: coordinates in
    metres, robot frame. Raises `RelmapError` if the file cannot be written, or its content would
    not be readable.
    """
    path = Path(path)
    if not len(log.points_robot):
        raise invalid(path, "not written: the log has no observation")
    good = (np.abs(log.points_robot) <= MAX_COORDINATE_M).all(axis=1)
    if not good.all():
        problem = f"not written: observation {np.argmin(good)} is not finite or out of range"
        raise invalid(path, f"{problem}, expected coordinates within {MAX_COORDINATE_M:g} metres")
    with replacing(path) as file, ExitStack() as opened:
        packed: BinaryIO | gzip.GzipFile = file
        if path.suffix == ".gz":
            packed = opened.enter_context(gzip.GzipFile("", "wb", _GZIP_LEVEL, file, mtime=0))
        packed.writelines(line.encode("ascii") for line in _lines(log))


def _lines(log: ObservationLog) -> Iterator[str]:
    names = ["iteration", *"xyz"[: log.points_robot.shape[1]]]
    names += [] if log.ids is None else ["id"]
    pairs = [pair for pair in _PAIRS if log.points_robot.shape[1] == 3 or "z" not in pair]
    pairs = pairs if log.covariances is not None else []
    yield ",".join([*names, *(f"c{pair}" for pair in pairs)]) + "\n"
    for begin in range(0, len(log.iteration), _ROWS_AT_ONCE):
        rows = slice(begin, begin + _ROWS_AT_ONCE)
        columns: list[Iterable[int | float]] = [log.iteration[rows].tolist()]
        columns += [axis.tolist() for axis in log.points_robot[rows].T]
        if log.ids is not None:
            columns.append(log.ids[rows].tolist())
        for pair in pairs:
            assert log.covariances is not None
            a, b = ("xyz".index(axis) for axis in pair)
            columns.append(log.covariances[rows, a, b].tolist())
        texts = (map(repr, column) for column in columns)
        yield "".join(map("{}\n".format, map(",".join, zip(*texts, strict=True))))


def _members(folder: Path) -> list[Path]:
    return [folder / name for name in FILE_NAMES if os.path.isfile(folder / name)]
