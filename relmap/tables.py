"""Tables that hold text, gaps and whole numbers: the project's own CSV files."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.textfile import quoted, shown
from relmap.files import read_text

Kind = Literal["int", "float", "float or empty", "text"]
"""What a column of a table holds; ``float or empty`` reads an empty cell as NaN."""


def compressed(text: str) -> bytes:
    """Return the text as gzip data that depends on nothing but the text."""
    return gzip.compress(text.encode(), compresslevel=5, mtime=0)


def number(value: float) -> str:
    """Return the shortest text that reads back as the very same float; NaN gives no text."""
    return "" if value != value else repr(float(value))


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV text; floats in full precision, NaN as an empty cell."""
    lines = [",".join(header)]
    lines.extend(
        ",".join(number(cell) if isinstance(cell, float) else str(cell) for cell in row)
        for row in rows
    )
    return "\n".join(lines) + "\n"


def read_table(path: Path, columns: Mapping[str, Kind]) -> dict[str, NDArray[Any]]:
    """Read the named columns of a CSV file with a header line; other columns are passed over.

    Parameters
    ----------
    path : Path
        ``.csv`` or ``.csv.gz``.
    columns : mapping of str to Kind
        Wanted columns and what they hold.

    Returns
    -------
    dict of str to (n,) array
        int64, float64 or str arrays, in the order of the file.

    Raises
    ------
    RelmapError
        Where the file cannot be read, lacks a column or holds something else in a cell.
    """
    try:
        records = [
            line for line in enumerate(csv.reader(read_text(path).split("\n")), 1) if line[1]
        ]
    except csv.Error as error:
        raise RelmapError(f"{shown(path)}: not a CSV file: {error}") from error
    if not records:
        raise RelmapError(f"{shown(path)}: is empty, expected the header {','.join(columns)}")
    header = [name.strip() for name in records[0][1]]
    for name in columns:
        if name not in header:
            raise RelmapError(f"{_at(path, records[0][0])}: no column {name} in the header")
    for line, cells in records[1:]:
        if len(cells) != len(header):
            raise RelmapError(f"{_at(path, line)}: {len(cells)} fields, expected {len(header)}")
    lines = [line for line, _ in records[1:]]
    table = {}
    for name, kind in columns.items():
        k = header.index(name)
        texts = [cells[k].strip() for _, cells in records[1:]]
        table[name] = _column(path, name, kind, texts, lines)
    return table


def _at(path: Path, line: int) -> str:
    return f"{shown(path)}: line {line}"


def _column(path: Path, name: str, kind: Kind, texts: list[str], lines: list[int]) -> NDArray[Any]:
    if kind == "text":
        return np.array(texts, dtype=np.str_)
    with suppress(ValueError, OverflowError):
        return _numbers(texts, kind)
    for text, line in zip(texts, lines, strict=True):
        try:
            _numbers([text], kind)
        except (ValueError, OverflowError):
            wanted = "a whole number" if kind == "int" else "a number of metres"
            where = f"{_at(path, line)}, field {name}"
            raise RelmapError(f"{where}: {quoted(text)} is not {wanted}") from None
    raise AssertionError("a column is bad where none of its cells is")


def _numbers(texts: list[str], kind: Kind) -> NDArray[Any]:
    """Return the numbers in the cells (n,); ValueError or OverflowError where one is none."""
    if kind == "int":
        return np.array(list(map(int, texts)), dtype=np.int64)
    gaps = np.array([kind == "float or empty" and not text for text in texts], dtype=bool)
    values = np.array([float(text or "nan") for text in texts], dtype=np.float64)
    if not ((np.abs(values) <= MAX_COORDINATE_M) | gaps).all():
        raise ValueError
    return values
