"""Data frames of pandas and polars, and Parquet files, as tables of observations."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.foreign import PARQUET
from relmap.datasets.own_columns import BY_NAME, Ids, check_columns, chosen, log_of
from relmap.datasets.table import MAX_NUMBERS, Column
from relmap.datasets.textfile import invalid, quoted, shown


def log_of_frame(frame: Any, columns: Mapping[str, str] | None = None) -> ObservationLog:
    """Return the log in a data frame.

    Parameters
    ----------
    frame : pandas.DataFrame or polars.DataFrame
        One row per observation.
    columns : mapping of str to str, optional
        Column names of ``iteration``, ``stamp`` (seconds, or a time), ``x``, ``y``, ``z`` (robot
        frame, metres) and ``id``, if different. Iteration or stamp, z and id may be missing.

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
    check_columns(columns or {})
    if not (hasattr(frame, "columns") and hasattr(frame, "shape")):
        raise RelmapError(f"expected a DataFrame of pandas or polars, got a {type(frame).__name__}")
    theirs = chosen(path, [str(name) for name in frame.columns], columns or {})
    found = {ours: frame[name].to_numpy() for ours, name in theirs.items()}
    return log_of_columns(path, found, first=0)


def read_parquet(path: Path, columns: Mapping[str, str]) -> dict[str, NDArray[Any]]:
    """Return the used columns of a Parquet file."""
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        raise invalid(path, f"is {PARQUET}: pip install 'relmap[parquet]' to read it") from None
    try:
        with parquet.ParquetFile(path) as file:
            wanted = chosen(path, list(file.schema_arrow.names), columns)
            if file.metadata.num_rows * len(wanted) > MAX_NUMBERS:
                raise invalid(path, f"more than {MAX_NUMBERS} numbers in its columns")
            table = file.read(columns=list(wanted.values()))
            return {ours: table.column(name).to_numpy() for ours, name in wanted.items()}
    except (ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        reason = quoted(str(error).partition("\n")[0])
        raise invalid(path, f"cannot be read as {PARQUET}: {reason}") from error


def log_of_columns(path: Path, found: Mapping[str, NDArray[Any]], first: int = 1) -> ObservationLog:
    """Return the log in the columns of a frame, whose rows are counted from `first`."""
    used, ids, columns = [BY_NAME[ours] for ours in found], Ids(), []
    n = len(next(iter(found.values())))
    for column in used:
        cells = found[column.name]
        if column.name != "id":
            columns.append(_as_floats(path, column, cells, first))
            continue
        for row, cell in enumerate(cells.tolist()):
            ids.add(_as_text(cell), f"{shown(path)}: row {first + row}, field id")
        columns.append(np.full(n, -1.0))
    return log_of(path, used, np.column_stack(columns), np.arange(first, first + n), "row", ids)


def _as_text(cell: object) -> str:
    missing = cell is None or cell != cell or type(cell).__name__ == "NAType"
    return "" if missing else str(cell).strip()


def _as_floats(path: Path, column: Column, cells: NDArray[Any], first: int) -> Floats:
    if cells.dtype.kind == "M" and column.name == "stamp":
        seconds = cells.astype("datetime64[ns]").astype(np.int64) / 1e9
        return np.where(np.isnat(cells), np.nan, seconds)
    try:
        if column.name == "stamp" and all(hasattr(cell, "timestamp") for cell in cells):
            return np.array([cell.timestamp() for cell in cells])  # times in a time zone
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
