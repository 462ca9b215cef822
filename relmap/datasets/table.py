"""Tables of numbers in CSV files, read fast, with the exact place of whatever is wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.number_rows import parse_number, too_many
from relmap.datasets.textfile import Head, open_text, quoted, read_head, require_utf8, shown

MAX_EXACT_INTEGER = 2**53 - 1
"""Beyond this a float64 no longer tells neighbouring integers apart."""

MAX_NUMBERS = 1 << 25
"""Numbers in a table at most: some seven million observations."""

_BATCH_CHARACTERS = 1 << 22
_MOST_NAMES = 12
"""Messages list no more columns than this."""


@dataclass(frozen=True)
class Column:
    """One column that a table may have.

    Attributes
    ----------
    name : str
        As it stands in the header.
    low, high : float
        The least and the greatest value, both allowed.
    unit : str
        For messages; empty for a count.
    integer : bool
        Whether only whole numbers are allowed.
    required : bool
        Whether the table must have it.
    empty : float or None
        What an empty cell stands for; None where it is an error.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    integer: bool = False
    required: bool = True
    empty: float | None = None

    @property
    def expected(self) -> str:
        """Say what a cell must hold."""
        kind = "an integer" if self.integer else "a number"
        unit = f" of {self.unit}" if self.unit else ""
        return f"{kind}{unit} from {self.low:.10g} to {self.high:.16g}"


@dataclass(frozen=True, eq=False)
class Table:
    """A table as read: every column checked.

    Attributes
    ----------
    path : Path
        The file.
    comments : tuple of str
        Its comment lines, without the ``#``.
    columns : dict of (n,) float64
        By name; only those the file has.
    lines : (n,) int64
        1-based line of the file that each row stands in.
    place : str
        What messages call that number: a line, or a row where the file has no lines.
    """

    path: Path
    comments: tuple[str, ...]
    columns: dict[str, NDArray[np.float64]]
    lines: NDArray[np.int64]
    place: str = "line"

    def integers(self, name: str) -> NDArray[np.int64]:
        """Return a column of whole numbers."""
        return self.columns[name].astype(np.int64)

    def fail(self, row: int, name: str, problem: str) -> NoReturn:
        """Raise a RelmapError that names file, line and field of a 0-based row."""
        where = f"{self.place} {self.lines[row]}, field {name}"
        raise RelmapError(f"{shown(self.path)}: {where}: {problem}")


def read_table(path: Path, columns: Sequence[Column]) -> Table:
    """Read a CSV file whose header names some of the columns, in any order.

    Empty lines are passed over, and so are lines above the header that start with ``#``.

    Raises
    ------
    RelmapError
        Where header, row, cell or the file itself is not as the columns say.
    """
    with open_text(path) as stream:
        head = read_head(path, stream)
        rows = _Rows(path, _columns_in_file(path, head, columns))
        line = head.line + 1
        while batch := stream.readlines(_BATCH_CHARACTERS):
            rows.add(batch, line)
            line += len(batch)
    if not rows.values:
        raise RelmapError(f"{shown(path)}: holds a header but no row, expected at least one")
    values = np.concatenate(rows.values)
    by_name = {column.name: values[:, k].copy() for k, column in enumerate(rows.columns)}
    return Table(path, head.comments, by_name, np.concatenate(rows.lines))


def checked_table(
    path: Path,
    columns: Sequence[Column],
    values: NDArray[np.float64],
    lines: NDArray[np.int64],
    place: str = "line",
) -> Table:
    """Make a table of numbers that are no CSV file.

    Parameters
    ----------
    path : Path
        Where they come from.
    columns : sequence of Column
    values : (n, len(columns)) float64
    lines : (n,) int64
        1-based place of each row in the file.
    place : str
        What to call it.

    Raises
    ------
    RelmapError
        Where a number is not as its column says.
    """
    by_name = {column.name: values[:, k].copy() for k, column in enumerate(columns)}
    table = Table(path, (), by_name, lines, place)
    for row, k in _first_outside(values, columns):
        value = float(values[row, k])
        problem = _problem(columns[k], value)
        table.fail(row, columns[k].name, f"{value:.10g} {problem}, expected {columns[k].expected}")
    return table


def header_text(columns: Sequence[Column]) -> str:
    """Return the header that the columns ask for, optional ones in brackets."""
    first, *others = columns
    shown_columns = others[: _MOST_NAMES - 1]
    text = "".join(f",{c.name}" if c.required else f"[,{c.name}]" for c in shown_columns)
    return first.name + text + ",..." * (len(others) > len(shown_columns))


def _names(columns: Sequence[Column], comma: str) -> str:
    """Return the names of the columns for a message."""
    names = [column.name for column in columns]
    return comma.join(names[:_MOST_NAMES] + ["..."] * (len(names) > _MOST_NAMES))


def _columns_in_file(path: Path, head: Head, columns: Sequence[Column]) -> list[Column]:
    """Return the columns in the order of the file's header."""
    known = {column.name: column for column in columns}
    missing = [c.name for c in columns if c.required and c.name not in head.columns]
    unknown = [quoted(cell) for cell in head.columns if cell not in known]
    twice = [cell for cell in known if head.columns.count(cell) > 1]
    problems = [
        f"{problem} column{'s' * (len(names) > 1)} {', '.join(names[:10])}"
        for problem, names in (("missing", missing), ("unknown", unknown), ("duplicate", twice))
        if names
    ]
    if problems:
        raise RelmapError(
            f"{shown(path)}: line {head.line}: {' and '.join(problems)}; "
            f"expected the header {header_text(columns)} (known columns: {_names(columns, ', ')})"
        )
    return [known[cell] for cell in head.columns]


class _Rows:
    """Parses batches of lines and keeps their values and line numbers."""

    def __init__(self, path: Path, columns: list[Column]) -> None:
        self.columns = columns
        self.values: list[NDArray[np.float64]] = []
        self.lines: list[NDArray[np.int64]] = []
        self._path = path
        self._count = 0

    def add(self, batch: list[str], first_line: int) -> None:
        values = parse_fast(batch, len(self.columns))
        numbers = np.arange(first_line, first_line + len(batch))
        if values is None:
            filled = [k for k, text in enumerate(batch) if text.strip()]
            batch, numbers = [batch[k] for k in filled], numbers[filled]
            rows = [self._exact(text, int(n)) for text, n in zip(batch, numbers, strict=True)]
            values = np.array(rows, dtype=np.float64).reshape(-1, len(self.columns))
        self._check(values, batch, numbers)
        if len(values):
            self._count += values.size
            if self._count > MAX_NUMBERS:
                raise too_many(self._path, int(numbers[-1]), MAX_NUMBERS)
            self.values.append(values)
            self.lines.append(numbers)

    def _exact(self, text: str, line: int) -> list[float]:
        require_utf8(self._path, line, text)
        cells = text.split(",")
        if len(cells) != len(self.columns):
            raise RelmapError(
                f"{shown(self._path)}: line {line}: {len(cells)} fields in {quoted(text)}, "
                f"expected {len(self.columns)}: {_names(self.columns, ',')}"
            )
        return [self._number(c, cell, line) for c, cell in zip(self.columns, cells, strict=True)]

    def _number(self, column: Column, cell: str, line: int) -> float:
        cell = cell.strip()
        if not cell and column.empty is not None:
            return column.empty
        try:
            return parse_number(cell)
        except ValueError:
            self._fail(line, column, cell, "is empty" if not cell else "is not a number")

    def _check(
        self, values: NDArray[np.float64], batch: list[str], lines: NDArray[np.int64]
    ) -> None:
        for row, k in _first_outside(values, self.columns):
            problem = _problem(self.columns[k], float(values[row, k]))
            self._fail(int(lines[row]), self.columns[k], batch[row].split(",")[k], problem)

    def _fail(self, line: int, column: Column, cell: str, problem: str) -> NoReturn:
        raise RelmapError(
            f"{shown(self._path)}: line {line}, field {column.name}: {quoted(cell)} {problem}, "
            f"expected {column.expected}"
        )


def _first_outside(values: NDArray[np.float64], columns: Sequence[Column]) -> list[tuple[int, int]]:
    """Return row and column of the first cell that its column does not allow, if any."""
    found = []
    for k, column in enumerate(columns):
        cells = values[:, k]
        good = (cells >= column.low) & (cells <= column.high)
        if column.integer:
            good &= cells == np.rint(cells)
        if not good.all():
            found.append((int(np.argmin(good)), k))
    return sorted(found)[:1]


def _problem(column: Column, value: float) -> str:
    """Say why a column does not allow a value."""
    if not math.isfinite(value):
        return "is not finite"
    if column.integer and value != round(value):
        return "is not an integer"
    return "is out of range"


def parse_fast(batch: list[str], width: int) -> NDArray[np.float64] | None:
    """Return the numbers of plain lines, (n, width); None where a line is anything else."""
    if not batch[0].strip():
        return None
    try:
        values = np.loadtxt(batch, delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.shape == (len(batch), width) else None
