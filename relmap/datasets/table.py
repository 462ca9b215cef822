"""Fast reading of numeric CSV tables, with exact error locations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.datasets.headers import Head, cells_of, read_head
from relmap.datasets.number_rows import parse_number, too_many
from relmap.datasets.textfile import invalid, listed, open_text, quoted, require_utf8, shown

MAX_EXACT_INTEGER = 2**53 - 1
"""Largest number below which float64 represents every integer."""

MAX_NUMBERS = 1 << 25
"""Maximum number of values in a table: some seven million observations."""

_BATCH_CHARACTERS = 1 << 22
_MOST_NAMES = 12
"""Maximum number of columns listed in messages."""


@dataclass(frozen=True)
class Column:
    """A column that a table may have: its values are from `low` to `high`, both allowed.

    The `unit` and the `advice` are for messages; `empty` is the value of an empty cell, None if it
    is an error.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    integer: bool = False
    required: bool = True
    empty: float | None = None
    advice: str = ""

    @property
    def expected(self) -> str:
        """Describe the allowed cells."""
        kind = "an integer" if self.integer else "a number"
        unit = f" of {self.unit}" if self.unit else ""
        advice = f" ({self.advice})" if self.advice else ""
        return f"{kind}{unit} from {self.low:.16g} to {self.high:.16g}{advice}"


@dataclass(frozen=True, eq=False)
class Table:
    """A table with all columns of the file, validated.

    `lines` is the 1-based line of the file for each row; messages call it `place`: a line, or a row
    if the file has no lines.
    """

    path: Path
    comments: tuple[str, ...]
    columns: dict[str, Floats]
    lines: Ints
    place: str = "line"

    def integers(self, name: str) -> Ints:
        """Return a column of whole numbers."""
        return self.columns[name].astype(np.int64)

    def fail(self, row: int, name: str, problem: str) -> NoReturn:
        """Raise a RelmapError with file, line and field of a 0-based row."""
        raise invalid(self.path, f"{self.place} {self.lines[row]}, field {name}: {problem}")


def read_table(path: Path, columns: Sequence[Column], advice: str = "") -> Table:
    """Read a CSV file whose header names some of the columns, in any order.

    Empty lines are skipped, and so are lines above the header that start with ``#``. Cells are
    separated as in the header, by commas, semicolons or tabs, and may be quoted; between semicolons
    numbers may have a decimal comma. The `advice` ends the message about a wrong header. Raises
    `RelmapError` if header, row, cell or file are invalid.
    """
    parts, count = [], 0
    with open_text(path) as stream:
        head = read_head(path, stream)
        found = _columns_in_file(path, head, columns, advice)
        line = head.line + 1
        while batch := stream.readlines(_BATCH_CHARACTERS):
            values, lines = _parsed(path, batch, line, found, head.separator)
            line += len(batch)
            count += values.size
            if count > MAX_NUMBERS:
                raise too_many(path, int(lines[-1]), MAX_NUMBERS)
            parts.append((values, lines))
    if not count:
        raise invalid(path, "holds a header but no row, expected at least one")
    values = np.concatenate([values for values, _ in parts])
    by_name = {column.name: values[:, k].copy() for k, column in enumerate(found)}
    return Table(path, head.comments, by_name, np.concatenate([lines for _, lines in parts]))


def checked_table(
    path: Path, columns: Sequence[Column], values: Floats, lines: Ints, place: str = "line"
) -> Table:
    """Make a validated `Table` of numbers (n, columns) from a file other than CSV."""
    by_name = {column.name: values[:, k].copy() for k, column in enumerate(columns)}
    table = Table(path, (), by_name, lines, place)
    for row, k, problem in _first_outside(values, columns):
        column = columns[k]
        table.fail(row, column.name, f"{values[row, k]:.10g} {problem}, expected {column.expected}")
    return table


def header_text(columns: Sequence[Column]) -> str:
    """Return the expected header, with optional columns in brackets."""
    first, *others = columns
    shown_columns = others[: _MOST_NAMES - 1]
    text = "".join(f",{c.name}" if c.required else f"[,{c.name}]" for c in shown_columns)
    return first.name + text + ",..." * (len(others) > len(shown_columns))


def _columns_in_file(
    path: Path, head: Head, columns: Sequence[Column], advice: str
) -> list[Column]:
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
        expected = f"{header_text(columns)} (known columns: {listed([*known])}){advice}"
        problem = f"line {head.line}: {' and '.join(problems)}"
        raise invalid(path, f"{problem}; expected the header {expected}")
    return [known[cell] for cell in head.columns]


def _parsed(
    path: Path, batch: list[str], first_line: int, columns: Sequence[Column], separator: str
) -> tuple[Floats, Ints]:
    """Return the numbers (n, columns) in lines of a file, and the line of each row."""
    values = parse_fast(batch, len(columns), separator)
    lines = np.arange(first_line, first_line + len(batch))
    if values is None:
        filled = [k for k, text in enumerate(batch) if text.strip()]
        batch, lines = [batch[k] for k in filled], lines[filled]
        rows = [
            _exact(path, text, int(n), columns, separator)
            for text, n in zip(batch, lines, strict=True)
        ]
        values = np.array(rows, dtype=np.float64).reshape(-1, len(columns))
    for row, k, problem in _first_outside(values, columns):
        cell = cells_of(batch[row], separator)[k]
        raise _wrong_cell(path, int(lines[row]), columns[k], cell, problem)
    return values, lines


def _exact(
    path: Path, text: str, line: int, columns: Sequence[Column], separator: str
) -> list[float]:
    require_utf8(path, line, text)
    cells = cells_of(text, separator)
    if len(cells) != len(columns):
        problem = f"line {line}: {len(cells)} fields in {quoted(text)}"
        names = listed([column.name for column in columns], ",")
        raise invalid(path, f"{problem}, expected {len(columns)}: {names}")
    row = []
    for column, cell in zip(columns, cells, strict=True):
        if not cell and column.empty is not None:
            row.append(column.empty)
            continue
        try:
            row.append(parse_number(cell.replace(",", ".") if separator == ";" else cell))
        except ValueError:
            problem = "is not a number" if cell else "is empty"
            raise _wrong_cell(path, line, column, cell, problem) from None
    return row


def _wrong_cell(path: Path, line: int, column: Column, cell: str, problem: str) -> RelmapError:
    where = f"{shown(path)}: line {line}, field {column.name}"
    return RelmapError(f"{where}: {quoted(cell)} {problem}, expected {column.expected}")


def _first_outside(values: Floats, columns: Sequence[Column]) -> list[tuple[int, int, str]]:
    """Return row and column of the first invalid cell, if any, and the reason."""
    found = []
    for k, column in enumerate(columns):
        cells = values[:, k]
        good = (cells >= column.low) & (cells <= column.high)
        if column.integer:
            good &= cells == np.rint(cells)
        if not good.all():
            row = int(np.argmin(good))
            problem = "is out of range"
            if not np.isfinite(cells[row]):
                problem = "is not finite"
            elif column.integer and cells[row] != np.rint(cells[row]):
                problem = "is not an integer"
            found.append((row, k, problem))
    return sorted(found)[:1]


def parse_fast(batch: list[str], width: int, separator: str = ",") -> Floats | None:
    """Return the numbers of plain lines, (n, width); None if a line is anything else."""
    if not batch[0].strip():
        return None
    try:
        values = np.loadtxt(batch, delimiter=separator, comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.shape == (len(batch), width) else None
