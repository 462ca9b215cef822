"""The columns of tables of any origin, and conversion to a log."""

from __future__ import annotations

import logging
import math
from array import array
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.datasets.number_rows import parse_number
from relmap.datasets.observation_csv import COLUMNS, log_of_table
from relmap.datasets.table import MAX_EXACT_INTEGER, Column, checked_table
from relmap.datasets.textfile import invalid, quoted, shown

MAX_NAME = 200
"""Maximum number of characters of a text id."""

BY_NAME = {column.name: column for column in COLUMNS}
_LOG = logging.getLogger(__name__)


def check_columns(columns: Mapping[str, str]) -> None:
    """Raise a `RelmapError` for columns that the observation log does not have, or one in two."""
    unknown = [quoted(name) for name in columns if name not in BY_NAME]
    if unknown:
        raise RelmapError(f"columns: {', '.join(unknown)}, expected some of {', '.join(BY_NAME)}")
    names = list(columns.values())
    twice = [quoted(name) for name in names if names.count(name) > 1]
    if twice:
        raise RelmapError(f"columns: {twice[0]} is given twice, expected different columns")


def chosen(path: Path, there: list[str], columns: Mapping[str, str]) -> dict[str, str]:
    """Return the names of the used columns in the table."""
    names = {ours: columns.get(ours, ours) for ours in BY_NAME}
    wanted = {ours: theirs for ours, theirs in names.items() if theirs in there}
    needed = {"x", "y", *columns}
    if not wanted.keys() & {"iteration", "stamp"}:
        needed.add("iteration")
    missing = [quoted(names[ours]) for ours in (*columns, *names) if ours in needed - wanted.keys()]
    several = [quoted(theirs) for theirs in set(wanted.values()) if there.count(theirs) > 1]
    if missing or several:
        problem = f"no column {missing[0]}" if missing else f"two columns {several[0]}"
        listed = ", ".join(map(quoted, there[:12])) + ", ..." * (len(there) > 12)
        raise invalid(path, f"{problem}, expected one; there are {listed}")
    others = [quoted(name) for name in there if name not in wanted.values()]
    if others:
        listed = ", ".join(others[:12]) + ", ..." * (len(others) > 12)
        _LOG.warning("%s: other columns are ignored: %s", shown(path), listed)
    return wanted


class Ids:
    """The ids of rows, numbers or texts; the type is determined after all are read."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}
        self._of_row = array("q")

    def add(self, text: str, where: str) -> None:
        """Add the id of a row, empty without one; RelmapError if it is too long."""
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
        order = sorted(range(len(names)), key=names.__getitem__)
        rank = np.empty(len(names) + 1)
        rank[order], rank[-1] = np.arange(len(names)), -1
        return rank[of_row], tuple(names[k] for k in order)


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
