"""Tables with text, missing values and integers: the project's own CSV files."""

from __future__ import annotations

import csv
import gzip
import math
import sys
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.textfile import invalid, numbered_lines, quoted, shown

Kind = Literal["int", "float", "float or empty", "text", "corners", "int list"]
"""Type of a column of a table.

``corners`` is points in space, ``x y z;x y z;...``, and reads as an array (k, 3), and ``int list``
is ``k;k;...``.
``float`` is measured or given, at most `MAX_COORDINATE_M`; ``float or empty`` is computed, at most
`MAX_RESULT_M`, and an empty cell reads as NaN.
"""

MAX_RESULT_M = 1e70
"""Largest coordinate of a drifted map or path, metres: its square is still finite."""

MAX_WORD = 32
"""Maximum number of characters of a text: numpy allocates the longest for each row."""

WANTED = {
    "int": "a whole number",
    "corners": "corners x y z;x y z;...",
    "int list": "whole numbers k;k;...",
}
"""What is said to be expected in a cell; else metres."""


def compressed(text: str) -> bytes:
    """Return the text as reproducible gzip data."""
    return gzip.compress(text.encode(), compresslevel=5, mtime=0)


def number(value: float) -> str:
    """Return the shortest text that reads back as the same float; NaN gives an empty text."""
    return "" if value != value else repr(float(value))


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV text; floats in full precision, NaN and None as empty cells."""
    lines = [header, *(map(_cell, row) for row in rows)]
    return "\n".join(map(",".join, lines)) + "\n"


def _cell(value: object) -> str:
    if value is None:
        return ""
    return number(value) if isinstance(value, float) else str(value)


def columns_text(columns: Mapping[str, NDArray[Any]]) -> str:
    """Return columns (n,) as CSV text, see `csv_text`."""
    cells = (column.tolist() for column in columns.values())
    return csv_text(list(columns), zip(*cells, strict=True))


def read_table(
    path: Path, columns: Mapping[str, Kind], optional: Collection[str] = ()
) -> dict[str, NDArray[Any]]:
    """Read the named columns of a CSV file with a header line; other columns are skipped.

    `path`: ``.csv`` or ``.csv.gz``; `columns`: wanted columns and their types; `optional`: columns
    that may be missing. Returns each column as an array (n,) of int64, float64, str or, of corners,
    objects, in the order of the file. Raises `RelmapError` if the file cannot be read, lacks a
    column or has an invalid cell.
    """
    found: dict[str, _Column] = {}
    width = 0
    reader = csv.reader(line for _, line in numbered_lines(path))
    for cells in _records(path, reader):
        if not found:
            header, width = [name.strip() for name in cells], len(cells)
            for name, kind in columns.items():
                if name not in header and name in optional:
                    continue
                if name not in header:
                    where = _at(path, reader.line_num)
                    raise RelmapError(f"{where}: no column {name} in the header")
                found[name] = _Column(name, kind, header.index(name))
            continue
        if len(cells) != width:
            where = _at(path, reader.line_num)
            raise RelmapError(f"{where}: {len(cells)} fields, expected {width}")
        for column in found.values():
            column.add(path, reader.line_num, cells)
    if not found:
        raise invalid(path, f"is empty, expected the header {','.join(columns)}")
    return {name: column.values for name, column in found.items()}


def _records(path: Path, reader: Iterator[list[str]]) -> Iterator[list[str]]:
    try:
        for cells in reader:
            if cells:
                yield cells
    except csv.Error as error:
        raise invalid(path, f"not a CSV file: {error}") from error


class _Column:
    """The cells of a column, as numbers of 8 bytes each or as short texts."""

    def __init__(self, name: str, kind: Kind, place: int) -> None:
        self._name = name
        self._kind = kind
        self._place = place
        self._numbers: array[Any] = array("q" if kind == "int" else "d")
        self._texts: list[str] = []
        self._ragged: list[NDArray[Any]] = []

    def add(self, path: Path, line: int, cells: list[str]) -> None:
        """Add the cell of a record."""
        text = cells[self._place].strip()
        if self._kind == "text":
            if len(text) > MAX_WORD:
                raise self._wrong(path, line, text, f"a word of at most {MAX_WORD} characters")
            self._texts.append(sys.intern(text))
            return
        wanted = WANTED.get(self._kind, "a number of metres")
        try:
            if self._kind == "corners":
                self._ragged.append(_corners(text))
            elif self._kind == "int list":
                self._ragged.append(np.array([int(k) for k in text.split(";") if text], np.int64))
            else:
                self._numbers.append(self._number(text))
        except (ValueError, OverflowError):
            raise self._wrong(path, line, text, wanted) from None

    def _number(self, text: str) -> float | int:
        if self._kind == "int":
            return int(text)
        if not text and self._kind == "float or empty":
            return math.nan
        value = float(text)
        limit = MAX_RESULT_M if self._kind == "float or empty" else MAX_COORDINATE_M
        if not abs(value) <= limit:
            raise ValueError
        return value

    def _wrong(self, path: Path, line: int, text: str, wanted: str) -> RelmapError:
        where = f"{_at(path, line)}, field {self._name}"
        return RelmapError(f"{where}: {quoted(text)} is not {wanted}")

    @property
    def values(self) -> NDArray[Any]:
        """The cells, (n,)."""
        if self._kind == "text":
            return np.array(self._texts, dtype=np.str_)
        if self._kind in ("corners", "int list"):
            ragged = np.empty(len(self._ragged), dtype=object)
            ragged[:] = self._ragged
            return ragged
        return np.array(self._numbers, dtype=np.int64 if self._kind == "int" else np.float64)


def _corners(text: str) -> Floats:
    """Return the corners (k, 3) of a cell; ValueError where it holds anything else."""
    corners = np.array([corner.split() for corner in text.split(";") if text], dtype=np.float64)
    if corners.size and (corners.shape[1:] != (3,) or not (np.abs(corners) <= MAX_RESULT_M).all()):
        raise ValueError
    return corners.reshape(-1, 3)


def _at(path: Path, line: int) -> str:
    return f"{shown(path)}: line {line}"
