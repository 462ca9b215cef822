"""Tables with arbitrary column names: CSV and Parquet files, data frames.

A row is one observation of a landmark. ``--columns x=px,y=py,iteration=frame,stamp=t,id=name``
names the columns; the defaults are the names of `relmap.datasets.observation_csv`. Other columns
are ignored, with a warning. Times may replace iteration numbers; ids may be texts.
"""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.foreign import PARQUET, foreign_at
from relmap.datasets.frames import log_of_columns, read_parquet
from relmap.datasets.headers import read_head
from relmap.datasets.number_rows import parse_number, too_many
from relmap.datasets.own_columns import BY_NAME, Ids, check_columns, chosen, log_of
from relmap.datasets.table import MAX_NUMBERS, Column
from relmap.datasets.textfile import invalid, open_text, quoted, require_utf8, shown


@dataclass(frozen=True)
class OwnTable:
    """Reads a table, CSV or Parquet.

    `columns`: names of the columns of the observation log in the table.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    name = "own-table"
    description = "a table, CSV or Parquet, whose columns are named by --columns"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a Parquet file: other tables are read as observation logs."""
        return path.is_file() and foreign_at(path) == PARQUET

    def load(self, path: Path) -> ObservationLog:
        """Read the log."""
        check_columns(self.columns)
        if foreign_at(path) == PARQUET:
            return log_of_columns(path, read_parquet(path, self.columns))
        return _read_text(path, self.columns)


def _read_text(path: Path, columns: Mapping[str, str]) -> ObservationLog:
    values, lines, ids = array("d"), array("q"), Ids()
    with open_text(path) as stream:
        head = read_head(path, stream)
        (there,) = csv.reader([head.separator.join(head.columns)], delimiter=head.separator)
        wanted = chosen(path, there, columns)
        used = [BY_NAME[ours] for ours in wanted]
        at = [(BY_NAME[ours], there.index(theirs)) for ours, theirs in wanted.items()]
        for line, cells in _rows(path, stream, head.line, head.separator):
            if len(cells) != len(there):
                problem = f"{len(cells)} fields, expected {len(there)} as in the header"
                raise invalid(path, f"line {line}: {problem}")
            for column, k in at:
                text, where = cells[k].strip(), f"{shown(path)}: line {line}, field {there[k]}"
                if column.name == "id":
                    ids.add(text, where)
                    values.append(-1.0)
                else:
                    values.append(_number(text, head.separator, column, where))
            lines.append(line)
            if len(values) > MAX_NUMBERS:
                raise too_many(path, line, MAX_NUMBERS)
    table = np.array(values, dtype=np.float64).reshape(-1, len(used))
    return log_of(path, used, table, np.array(lines, dtype=np.int64), "line", ids)


def _number(text: str, separator: str, column: Column, where: str) -> float:
    try:
        return parse_number(text.replace(",", ".") if separator == ";" else text)
    except ValueError:
        raise RelmapError(f"{where}: {quoted(text)}, expected {column.expected}") from None


def _rows(
    path: Path, stream: Iterable[str], line: int, separator: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield the non-empty rows of a text table, and their lines."""

    def checked() -> Iterator[str]:
        for number, text in enumerate(stream, line + 1):
            require_utf8(path, number, text)
            yield text

    reader = csv.reader(checked(), delimiter=separator, strict=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield line + reader.line_num, cells
    except csv.Error as error:
        raise invalid(path, f"line {line + reader.line_num}: {error}") from error
