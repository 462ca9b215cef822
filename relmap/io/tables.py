"""Tables with text, missing values and integers: the project's own CSV files."""

from __future__ import annotations

import csv
import gzip
import math
import sys
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.own_table import MAX_NAME
from relmap.datasets.textfile import invalid, numbered_lines, quoted, shown

Kind = Literal["int", "float", "float or empty", "text", "name", "corners", "int list"]
"""Type of a column of a table.

``corners`` is points in space, ``x y z;x y z;...``, and reads as an array (k, 3), and ``int list``
is ``k;k;...``.
``float`` is measured or given, at most `MAX_COORDINATE_M`; ``float or empty`` is computed, at most
`MAX_RESULT_M`, and an empty cell reads as NaN.
"""

MAX_RESULT_M = 1e70
"""Largest coordinate of a drifted map or path, metres: its square is still finite."""

MOST = {"text": 32, "name": MAX_NAME}
"""Maximum number of characters; numpy allocates the longest text, but not name, for each row."""

WANTED = {
    "int": "a whole number",
    **{kind: f"a {kind} of at most {most} characters" for kind, most in MOST.items()},
    "corners": "corners x y z;x y z;...",
    "int list": "whole numbers k;k;...",
}
"""What is said to be expected in a cell; else metres."""


def compressed(text: str) -> bytes:
    """Return the text as reproducible gzip data."""
    return gzip.compress(text.encode(), compresslevel=5, mtime=0)


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV text; floats in full precision, NaN and None as empty cells."""
    return _text(header, (map(_cell, row) for row in rows))


def _text(header: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    return "\n".join(map(",".join, chain([header], rows))) + "\n"


def _cell(value: object) -> str:
    """Return the shortest text that reads back as the same value; empty for None and NaN."""
    if value is None or value != value:
        return ""
    return repr(float(value)) if isinstance(value, float) else str(value)


def columns_text(columns: Mapping[str, NDArray[Any]]) -> str:
    """Return columns (n,) as CSV text, see `csv_text`."""
    cells = (
        map(str if column.dtype.kind in "iu" else _cell, column.tolist())
        for column in columns.values()
    )
    return _text(list(columns), zip(*cells, strict=True))


def read_columns(
    path: Path, columns: Mapping[str, Kind], optional: Collection[str] = ()
) -> dict[str, NDArray[Any]]:
    """Read the named columns of a CSV file with a header line; other columns are skipped.

    `path`: ``.csv`` or ``.csv.gz``; `columns`: wanted columns and their types; `optional`: columns
    that may be missing. Returns each column as an array (n,) of int64, float64, str or, of corners,
    objects, in the order of the file. Raises `RelmapError` if the file cannot be read, lacks a
    column or has an invalid cell.
    """
    reader = csv.reader(line for _, line in numbered_lines(path))
    records = _records(path, reader)
    header = [name.strip() for name in next(records, [])]
    if not header:
        raise invalid(path, f"is empty, expected the header {','.join(columns)}")
    missing = [name for name in columns if name not in header and name not in optional]
    if missing:
        raise RelmapError(f"{_at(path, reader.line_num)}: no column {missing[0]} in the header")
    kinds = {name: kind for name, kind in columns.items() if name in header}
    places = {name: header.index(name) for name in kinds}
    found = {name: _column(kind) for name, kind in kinds.items()}
    for cells in records:
        where = _at(path, reader.line_num)
        if len(cells) != len(header):
            raise RelmapError(f"{where}: {len(cells)} fields, expected {len(header)}")
        for name, kind in kinds.items():
            text = cells[places[name]].strip()
            try:
                found[name].append(_value(kind, text))
            except (ValueError, OverflowError):
                wanted = WANTED.get(kind, "a number of metres")
                problem = f"{quoted(text)} is not {wanted}"
                raise RelmapError(f"{where}, field {name}: {problem}") from None
    return {name: _as_array(kind, found[name]) for name, kind in kinds.items()}


def _records(path: Path, reader: Iterator[list[str]]) -> Iterator[list[str]]:
    try:
        yield from filter(None, reader)
    except csv.Error as error:
        raise invalid(path, f"not a CSV file: {error}") from error


def _column(kind: Kind) -> Any:
    """Return an empty column: numbers of 8 bytes, or a list of anything else."""
    types = {"int": "q", "float": "d", "float or empty": "d"}
    return array(types[kind]) if kind in types else []


def _value(kind: Kind, text: str) -> Any:
    """Return the content of a cell; ValueError if it is not of its kind."""
    if kind in MOST:
        if len(text) > MOST[kind]:
            raise ValueError
        return sys.intern(text)
    if kind == "corners":
        corners = np.array([corner.split() for corner in text.split(";") if text], dtype=np.float64)
        far = not (np.abs(corners) <= MAX_RESULT_M).all()
        if corners.size and (corners.shape[1:] != (3,) or far):
            raise ValueError
        return corners.reshape(-1, 3)
    if kind == "int list":
        return np.array([int(k) for k in text.split(";") if text], np.int64)
    if kind == "int":
        return int(text)
    if not text and kind == "float or empty":
        return math.nan
    value = float(text)
    if not abs(value) <= (MAX_RESULT_M if kind == "float or empty" else MAX_COORDINATE_M):
        raise ValueError
    return value


def _as_array(kind: Kind, values: Any) -> NDArray[Any]:
    """Return the cells of a column, (n,)."""
    if kind in ("name", "corners", "int list"):
        ragged = np.empty(len(values), dtype=object)
        ragged[:] = values
        return ragged
    types = {"int": np.int64, "text": np.str_}
    return np.array(values, dtype=types.get(kind, np.float64))


def _at(path: Path, line: int) -> str:
    return f"{shown(path)}: line {line}"
