"""Lines of numbers, collected at 8 bytes per number."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Sequence
from operator import le
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.datasets.textfile import invalid, numbered_lines, quoted, warn

MAX_LISTED = 1 << 24
"""Maximum number of values in such rows: some two million poses."""


def too_many(path: Path, line: int, most: int) -> RelmapError:
    """Return the error for a file with more numbers than the memory limit."""
    return invalid(path, f"line {line}: more than {most} numbers, expected at most that")


def parse_number(cell: str) -> float:
    """Return the number in a cell, ValueError if it is none; grammar as of `table.parse_fast`."""
    if not _is_plain(cell):
        raise ValueError(cell)
    return float(cell)


def finite_numbers(cells: Iterable[str]) -> list[float]:
    """Return the numbers in cells; an empty list where any cell is not a finite number."""
    cells = [*cells]
    if not _is_plain("".join(cells)):
        return []
    try:
        numbers = [*map(float, cells)]
    except ValueError:
        return []
    # A sum of finite numbers is finite, unless it overflows.
    finite = math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))
    return numbers if finite else []


def _is_plain(text: str) -> bool:
    """Return whether a text has none of the characters that only Python allows in numbers."""
    return "_" not in text and text.isascii()


def read_rows(
    path: Path,
    limits: Sequence[float],
    what: str,
    expected: str,
    comment: str = "#",
    separator: str | None = None,
    empty: bool = False,
) -> NumberRows:
    """Read a file of rows of numbers.

    `limits`: the largest allowed magnitude of each number, finite. `what`, `expected`: description
    of a row and its content, for messages. `comment`: start of a comment. `separator`: separator of
    the numbers, also allowed after the last; white space by default. `empty`: whether a file
    without a row is read. Raises `RelmapError` if the file cannot be read, has no row, or a line is
    not a row.
    """
    rows = NumberRows(path, len(limits))
    for number, line in numbered_lines(path):
        cells = line.partition(comment)[0].strip().rstrip(separator).split(separator)
        row = finite_numbers(cells)
        if len(row) == len(limits) and all(map(le, map(abs, row), limits)):
            rows.add(row, number)
        elif any(cells):
            raise invalid(path, f"line {number}: {quoted(line)}, expected {expected}")
    if not (empty or len(rows.lines)):
        raise invalid(path, f"holds no {what}, expected {expected}")
    return rows


def warn_unsorted(path: Path, stamps_s: Floats, what: str) -> None:
    """Log a warning if rows that are used in order of time (n,) are not in it."""
    if late := int((np.diff(stamps_s) < 0).sum()):
        warn(path, f"{late} {what} out of order: all are sorted by time")


class NumberRows:
    """Rows of `width` numbers each and their lines; RelmapError if there are too many."""

    def __init__(self, path: Path, width: int) -> None:
        self._path = path
        self._width = width
        self._values = array("d")
        self._lines = array("q")

    def add(self, row: Sequence[float], line: int) -> None:
        """Add a row and the number of its line, counted from 1."""
        self._values.extend(row)
        self._lines.append(line)
        if len(self._values) > MAX_LISTED:
            raise too_many(self._path, line, MAX_LISTED)

    @property
    def values(self) -> Floats:
        """The numbers, (n, width)."""
        return np.array(self._values, dtype=np.float64).reshape(-1, self._width)

    @property
    def lines(self) -> Ints:
        """The line of each row, (n,)."""
        return np.array(self._lines, dtype=np.int64)
