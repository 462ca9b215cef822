"""Rows of numbers, gathered one by one at 8 bytes a number."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.textfile import shown

MAX_LISTED = 1 << 24
"""Numbers in such rows at most: some two million poses."""


def too_many(path: Path, line: int, most: int) -> RelmapError:
    """Return the error to raise where a file holds more numbers than memory is meant for."""
    problem = f"more than {most} numbers, expected at most that"
    return RelmapError(f"{shown(path)}: line {line}: {problem}")


class NumberRows:
    """Rows of as many numbers each, gathered one by one at 8 bytes a number.

    Parameters
    ----------
    path : Path
        Where they come from, for messages.
    width : int
    """

    def __init__(self, path: Path, width: int) -> None:
        self._path = path
        self._width = width
        self._values = array("d")
        self._lines = array("q")

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._lines)

    def add(self, row: Sequence[float], line: int) -> None:
        """Add a row that stands in a line, counted from 1.

        Raises
        ------
        RelmapError
            Where there are too many.
        """
        self._values.extend(row)
        self._lines.append(line)
        if len(self._values) > MAX_LISTED:
            raise too_many(self._path, line, MAX_LISTED)

    @property
    def values(self) -> NDArray[np.float64]:
        """The numbers, (n, width)."""
        return np.array(self._values, dtype=np.float64).reshape(-1, self._width)

    @property
    def lines(self) -> NDArray[np.int64]:
        """The line of each row, (n,)."""
        return np.array(self._lines, dtype=np.int64)
