"""Circles on the floor of an institute (J. Kurlbaum and U. Frese, DLR and University of Bremen).

``map.circles`` holds lines, ``#`` before a comment; metres and radians::

    STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi
    LANDMARK_C pX pY quality cXX cXY cYY id

A step of the odometry, then the circles seen after it, numbered by hand. The file's header puts X
to the robot's right and -Y ahead, seen from above the axes of an image. Here x is ahead and y to
the left, so x = -pY and y = -pX. That no circle lies behind the robot, and that it drives towards
-Y, show the one sign; for the other the header is taken at its word: numbers alone cannot tell a
building from its mirror image.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets.assembly import (
    MAX_COORDINATE_M,
    assemble_log,
    id_column,
    iteration_column,
)
from relmap.datasets.base import ObservationLog
from relmap.datasets.number_rows import NumberRows, parse_number
from relmap.datasets.table import Column, Table, checked_table
from relmap.datasets.textfile import (
    columns_of,
    members_of,
    numbered_lines,
    only_one,
    quoted,
    shown,
)

STEP = "STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi"
LANDMARK = "LANDMARK_C pX pY quality cXX cXY cYY id"

_COLUMNS = (
    iteration_column("step"),
    Column("pX", -MAX_COORDINATE_M, MAX_COORDINATE_M, "metres"),
    Column("pY", -MAX_COORDINATE_M, MAX_COORDINATE_M, "metres"),
    id_column("id", required=True),
)
_WORDS = ("STEP", "LANDMARK_C", "LANDMARK")
_ENDINGS = (".circles", ".circles.gz")


class DlrCircles:
    """Reads ``map.circles``, plain or gzipped, or a folder that holds just one such file."""

    name = "dlr-circles"
    description = f"DLR's circles, *.circles with lines {STEP!r} and {LANDMARK!r}"

    def recognises(self, path: Path) -> bool:
        """Tell whether the first line is a step or a circle, or a folder holds such a file."""
        if os.path.isdir(path):
            return bool(_files_in(path))
        first = " ".join(columns_of(path)).split()
        return len(first) > 1 and first[0] in _WORDS

    def load(self, path: Path) -> ObservationLog:
        """Read the log: planar, one iteration per step, ids negative where none was given.

        The odometry is passed over.  A circle with several ids is not identified.

        Raises
        ------
        RelmapError
            Where the content is not what the format promises: file, line, field.
        """
        table, steps = _read(_only_file(path))
        points_robot = -np.column_stack([table.columns["pY"], table.columns["pX"]])
        log = assemble_log(table, "step", points_robot, table.integers("id"))
        return replace(log, first_iteration=0, end_iteration=steps)


def read_ids(path: Path) -> NDArray[np.int64]:
    """Return the ids of all circles that were identified, ascending.

    Raises
    ------
    RelmapError
        As `DlrCircles.load`.
    """
    table, _ = _read(_only_file(path))
    ids = np.unique(table.integers("id"))
    return ids[ids >= 0]


def _files_in(folder: Path) -> list[Path]:
    """Return the logs in a folder, by the ends of their names and by their content."""
    return [file for file in members_of(folder, _ENDINGS) if DlrCircles().recognises(file)]


def _only_file(path: Path) -> Path:
    return only_one(path, _files_in(path) if os.path.isdir(path) else (), "*.circles")


def _read(path: Path) -> tuple[Table, int]:
    """Return the circles, checked, and the number of steps."""
    rows, steps = NumberRows(path, 4), 0
    for number, line in numbered_lines(path):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        numbers = _numbers(path, number, line, cells)
        if cells[0] == "STEP":
            steps += 1
            continue
        if not steps:
            _fail(path, number, line, f"comes before the first step, expected {STEP}")
        only_id = numbers[6] if len(numbers) == 7 else -1.0
        rows.add([steps - 1.0, *numbers[:2], only_id], number)
    if not len(rows):
        raise RelmapError(f"{shown(path)}: holds no circle, expected lines {LANDMARK}")
    return checked_table(path, _COLUMNS, rows.values, rows.lines), steps


def _numbers(path: Path, number: int, line: str, cells: Sequence[str]) -> list[float]:
    """Return the numbers of a line, after its first word and the name of an image."""
    if cells[0] not in _WORDS:
        _fail(path, number, line, f"begins with neither STEP nor {_WORDS[1]}")
    step = cells[0] == "STEP"
    try:
        numbers = [parse_number(cell) for cell in cells[2 if step else 1 :]]
    except ValueError:
        numbers = []
    complete = len(numbers) == 9 if step else len(numbers) >= 7
    if not complete or not all(map(math.isfinite, numbers)):
        _fail(path, number, line, f"expected finite numbers: {STEP if step else LANDMARK}")
    return numbers


def _fail(path: Path, number: int, line: str, problem: str) -> NoReturn:
    raise RelmapError(f"{shown(path)}: line {number}: {quoted(line)}: {problem}")
