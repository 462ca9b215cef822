"""Tables with arbitrary column names: CSV and Parquet files, data frames of pandas and polars.

A row is one observation of a landmark. ``--columns x=px,y=py,iteration=frame,stamp=t,id=name``
names the columns; the defaults are the names of `relmap.datasets.observation_csv`. Other columns
are ignored, with a warning. Times may replace iteration numbers; ids may be texts.
"""

from __future__ import annotations

import csv
import math
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.foreign import PARQUET, foreign_at
from relmap.datasets.headers import read_head
from relmap.datasets.number_rows import parse_number, too_many
from relmap.datasets.observation_csv import (
    CARTESIAN,
    COLUMNS,
    POLAR,
    POLAR_COLUMNS,
    is_polar,
    log_of_table,
)
from relmap.datasets.table import MAX_EXACT_INTEGER, MAX_NUMBERS, Column, checked_table
from relmap.datasets.textfile import invalid, listed, open_text, quoted, require_utf8, shown, warn

MAX_NAME = 200
"""Maximum number of characters of a text id."""

BY_NAME = {column.name: column for column in (*COLUMNS, *POLAR_COLUMNS)}


@dataclass(frozen=True)
class OwnTable:
    """Reads a table, CSV or Parquet; `columns`: their names, by those of the observation log."""

    columns: Mapping[str, str] = field(default_factory=dict)
    name = "own-table"
    description = "a table, CSV or Parquet, whose columns are named by --columns"

    def recognises(self, path: Path) -> bool:
        """Return whether it is a Parquet file: other tables are read as observation logs."""
        return foreign_at(path) == PARQUET

    def load(self, path: Path) -> ObservationLog:
        """Read the log."""
        _check_columns(self.columns)
        if foreign_at(path) == PARQUET:
            return _log_of_columns(path, _read_parquet(path, self.columns))
        return _read_text(path, self.columns)


def _read_text(path: Path, columns: Mapping[str, str]) -> ObservationLog:
    values, lines, ids = array("d"), array("q"), Ids()
    with open_text(path) as stream:
        head = read_head(path, stream)
        (there,) = csv.reader([head.separator.join(head.columns)], delimiter=head.separator)
        wanted = _chosen(path, there, columns)
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

    reader = csv.reader(checked(), delimiter=separator, skipinitialspace=True, strict=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield line + reader.line_num, cells
    except csv.Error as error:
        raise invalid(path, f"line {line + reader.line_num}: {error}") from error


def log_of_frame(frame: Any, columns: Mapping[str, str] | None = None) -> ObservationLog:
    """Return the log in a data frame.

    Parameters
    ----------
    frame : pandas.DataFrame or polars.DataFrame
        One row per observation.
    columns : mapping of str to str, optional
        Column names of ``iteration``, ``stamp`` (seconds, or a time), ``x``, ``y``, ``z`` (robot
        frame, metres) or ``range``, ``bearing``, ``elevation`` (metres, radians), and ``id``, if
        different. Iteration or stamp, z or elevation, and id may be missing.

    Returns
    -------
    ObservationLog

    Raises
    ------
    RelmapError
        If it is not a data frame, a column is missing or a value is invalid: with 0-based row and
        column.
    """
    path = Path("data frame")
    _check_columns(columns or {})
    if not (hasattr(frame, "columns") and hasattr(frame, "shape")):
        raise RelmapError(f"expected a DataFrame of pandas or polars, got a {type(frame).__name__}")
    names = {str(name): name for name in frame.columns}  # pandas also has names other than texts
    theirs = _chosen(path, [*map(str, frame.columns)], columns or {})
    found = {ours: frame[names[text]].to_numpy() for ours, text in theirs.items()}
    return _log_of_columns(path, found, first=0)


def _read_parquet(path: Path, columns: Mapping[str, str]) -> dict[str, NDArray[Any]]:
    """Return the used columns of a Parquet file."""
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        raise invalid(path, f"is {PARQUET}: pip install 'relmap[parquet]' to read it") from None
    try:
        with parquet.ParquetFile(path) as file:
            wanted = _chosen(path, list(file.schema_arrow.names), columns)
            if file.metadata.num_rows * len(wanted) > MAX_NUMBERS:
                raise invalid(path, f"more than {MAX_NUMBERS} numbers in its columns")
            table = file.read(columns=list(wanted.values()))
            return {ours: table.column(name).to_numpy() for ours, name in wanted.items()}
    except (ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        reason = quoted(str(error).partition("\n")[0])
        raise invalid(path, f"cannot be read as {PARQUET}: {reason}") from error


def _log_of_columns(
    path: Path, found: Mapping[str, NDArray[Any]], first: int = 1
) -> ObservationLog:
    """Return the log in the columns of a frame, whose rows are counted from `first`."""
    used, ids, columns = [BY_NAME[ours] for ours in found], Ids(), []
    n = len(next(iter(found.values())))
    for column in used:
        cells = found[column.name]
        if column.name != "id":
            columns.append(_as_floats(path, column, cells, first))
            continue
        for row, cell in enumerate(cells.tolist(), first):
            if np.ndim(cell):
                raise invalid(path, f"row {row}, field id: a list, expected a name or number")
            missing = cell is None or cell != cell or type(cell).__name__ == "NAType"
            ids.add("" if missing else str(cell).strip(), f"{shown(path)}: row {row}, field id")
        columns.append(np.full(n, -1.0))
    return log_of(path, used, np.column_stack(columns), np.arange(first, first + n), "row", ids)


def _as_floats(path: Path, column: Column, cells: NDArray[Any], first: int) -> Floats:
    if cells.dtype.kind == "M" and column.name == "stamp":
        seconds = cells.astype("datetime64[ns]").astype(np.int64) / 1e9
        return np.where(np.isnat(cells), np.nan, seconds)
    try:
        if column.name == "stamp" and all(hasattr(cell, "timestamp") for cell in cells):
            # Times in a time zone; a missing one differs from itself.
            return np.array([cell.timestamp() if cell == cell else np.nan for cell in cells])
        # Old versions of numpy convert a list with a single number.
        has_lists = cells.dtype.kind == "O" and any(map(np.ndim, cells))
        if cells.dtype.kind not in "biufO" or has_lists:
            raise ValueError(cells.dtype)
        return np.asarray(cells, dtype=np.float64)
    except (TypeError, ValueError):
        kinds = (isinstance(cell, int | float) for cell in cells.tolist())
        wrong = next((k for k, is_number in enumerate(kinds) if not is_number), 0)
        problem = f"row {first + wrong}, field {column.name}: {quoted(str(cells[wrong]))}"
        raise invalid(path, f"{problem}, expected {column.expected}") from None


def _check_columns(columns: Mapping[str, str]) -> None:
    """Raise a `RelmapError` for unknown columns, one in two, or both kinds of coordinates."""
    unknown = [quoted(name) for name in columns if name not in BY_NAME]
    if unknown:
        raise RelmapError(f"columns: {', '.join(unknown)}, expected some of {', '.join(BY_NAME)}")
    names = list(columns.values())
    twice = [quoted(name) for name in names if names.count(name) > 1]
    if twice:
        raise RelmapError(f"columns: {twice[0]} is given twice, expected different columns")
    kinds = [[name for name in columns if name in axes] for axes in (CARTESIAN, POLAR)]
    if all(kinds):
        both = " and ".join(names[0] for names in kinds)
        raise RelmapError(f"columns: {both}, expected either x, y or range, bearing")


def _chosen(path: Path, there: list[str], columns: Mapping[str, str]) -> dict[str, str]:
    """Return the names of the used columns in the table."""
    names = {ours: columns.get(ours, ours) for ours in BY_NAME}
    wanted = {ours: theirs for ours, theirs in names.items() if theirs in there}
    given = [ours for ours in columns if ours in (*CARTESIAN, *POLAR)]
    polar = given[0] in POLAR if given else is_polar(wanted)
    axes, others = (POLAR, CARTESIAN) if polar else (CARTESIAN, POLAR)
    wanted = {ours: theirs for ours, theirs in wanted.items() if ours not in others}
    needed = {*axes[:2], *columns}
    if not wanted.keys() & {"iteration", "stamp"}:
        needed.add("iteration")
    missing = [quoted(names[ours]) for ours in (*columns, *names) if ours in needed - wanted.keys()]
    several = [quoted(theirs) for theirs in set(wanted.values()) if there.count(theirs) > 1]
    if missing or several:
        problem = f"no column {missing[0]}" if missing else f"two columns {several[0]}"
        names_there = listed([*map(quoted, there)])
        raise invalid(path, f"{problem}, expected one; there are {names_there}")
    places = [wanted[axis] for axis in axes if axis in wanted]
    twice = [quoted(theirs) for theirs in places if places.count(theirs) > 1]
    if twice:
        expected = f"expected another name for each of {axes[0]}, {axes[1]} and {axes[2]}"
        raise invalid(path, f"columns: {twice[0]} would be two coordinates, {expected}")
    unused = [quoted(name) for name in there if name not in wanted.values()]
    if unused:
        warn(path, f"other columns are ignored: {listed(unused)}")
    return wanted


class Ids:
    """The ids of rows, numbers or texts; the type is determined after all are read."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}
        self._of_row = array("q")

    def add(self, text: str, where: str) -> None:
        """Add the id of a row, empty without one; RelmapError if it is too long."""
        # As `open_text` has them: the ids of a table are the same in any format.
        text = text.replace("\r\n", "\n").replace("\r", "\n")
        if len(text) > MAX_NAME:
            expected = f"expected at most {MAX_NAME} characters"
            raise RelmapError(f"{where}: {quoted(text)}, {expected}")
        self._of_row.append(self._index.setdefault(text, len(self._index)) if text else -1)

    def numbered(self) -> tuple[Floats, tuple[str, ...] | None]:
        """Return the id of each row (n,), negative for none, and their names if texts."""
        names, of_row = list(self._index), np.array(self._of_row, dtype=np.int64)
        numbers = [_whole(name) for name in names]
        if all(number is not None for number in numbers):
            values = np.array([*numbers, -1.0], dtype=np.float64)
            return values[of_row], None
        ordered = sorted(names)
        rank = {name: number for number, name in enumerate(ordered)}
        return np.array([*map(rank.__getitem__, names), -1.0])[of_row], tuple(ordered)


def _whole(text: str) -> float | None:
    try:
        value = parse_number(text)
    except ValueError:
        return None
    return value if abs(value) <= MAX_EXACT_INTEGER and value == math.floor(value) else None


def log_of(
    path: Path, used: list[Column], values: Floats, lines: Ints, place: str, ids: Ids | None
) -> ObservationLog:
    """Return the log given by the numbers (n, columns) of a table, and its ids.

    `lines`, `place`: as for `Table`; `ids`: the content of the id column, if any. Raises
    `RelmapError` if there is no row, or a number is out of the range of its column.
    """
    names = None
    for k, column in enumerate(used):
        if column.name == "id" and ids is not None:
            values[:, k], names = ids.numbered()
    if not len(values):
        raise invalid(path, "holds no row, expected at least one")
    table = checked_table(path, used, values, lines, place)
    stamps_s = table.columns.get("stamp")
    if "iteration" not in table.columns and stamps_s is not None:
        _, iteration = np.unique(stamps_s, return_inverse=True)
        table.columns["iteration"] = iteration.astype(np.float64)
    return replace(log_of_table(table), names=names)
