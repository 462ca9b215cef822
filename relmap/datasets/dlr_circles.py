"""Circles on the floor of an institute (J. Kurlbaum and U. Frese, DLR and University of Bremen).

``map.circles`` holds lines, ``#`` before a comment; metres and radians::

    STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi
    LANDMARK_C pX pY quality cXX cXY cYY id

A step of the odometry (the robot pose in its frame before the step), then the circles seen after
it, numbered by hand. In the file X points to the robot's right and -Y ahead; here x = -pY is ahead
and y = -pX to the left. The data confirm the sign of Y (no circle lies behind the robot); that of X
is the header's, since a map and its mirror image explain the numbers equally well. Phi goes from X
to Y, to the right, so that a turn to the left is -dPhi.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.datasets.assembly import (
    MAX_COORDINATE_M,
    assemble_log,
    id_column,
    iteration_column,
    metres_column,
)
from relmap.datasets.base import ObservationLog
from relmap.datasets.headers import columns_of, members_of, only_one
from relmap.datasets.number_rows import NumberRows, finite_numbers
from relmap.datasets.scans import planar_poses
from relmap.datasets.table import Column, Table, checked_table
from relmap.datasets.textfile import invalid, numbered_lines, quoted

STEP = "STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi"
LANDMARK = "LANDMARK_C pX pY quality cXX cXY cYY id"

_VARIANCE = Column("cXX", 0, 1e18, "square metres")
_COLUMNS = (
    iteration_column("step"),
    metres_column("pX"),
    metres_column("pY"),
    id_column("id"),
    _VARIANCE,
    Column("cXY", -1e18, 1e18, "square metres"),
    replace(_VARIANCE, name="cYY"),
)
_WORDS = ("STEP", "LANDMARK_C", "LANDMARK")
_ENDINGS = (".circles", ".circles.gz")


class DlrCircles:
    """Reads ``map.circles``, plain or gzipped, or a folder with exactly one such file."""

    name = "dlr-circles"
    description = f"DLR's circles, *.circles with lines {STEP!r} and {LANDMARK!r}"

    def recognises(self, path: Path) -> bool:
        """Return whether the first line is a step or a circle, or a folder contains such a file."""
        if os.path.isdir(path):
            return bool(_files_in(path))
        first = " ".join(columns_of(path)).split()
        return len(first) > 1 and first[0] in _WORDS

    def load(self, path: Path) -> ObservationLog:
        """Read the log: planar, one iteration per step, ids negative for unidentified circles.

        The covariances are used if all are positive definite. A circle with several ids counts as
        not identified.
        """
        table, steps = _read(_only_file(path))
        points_robot = -np.column_stack([table.columns["pY"], table.columns["pX"]])
        xx, xy, yy = (table.columns[name] for name in ("cYY", "cXY", "cXX"))
        covariances = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
        definite = bool((xx * yy > xy**2).all())
        noise = covariances if definite else None
        log = assemble_log(table, "step", points_robot, table.integers("id"), noise)
        odometry = planar_poses(-steps[:, 1], -steps[:, 0], -steps[:, 2])
        odometry[0] = math.nan
        return replace(log, first_iteration=0, end_iteration=len(steps), odometry=odometry)


def read_ids(path: Path) -> Ints:
    """Return the ids of all identified circles, ascending; errors as for `DlrCircles.load`."""
    table, _ = _read(_only_file(path))
    ids = np.unique(table.integers("id"))
    return ids[ids >= 0]


def _files_in(folder: Path) -> list[Path]:
    """Return the logs in a folder, by extension and content."""
    return [file for file in members_of(folder, _ENDINGS) if DlrCircles().recognises(file)]


def _only_file(path: Path) -> Path:
    return only_one(path, _files_in(path) if os.path.isdir(path) else (), "circle log", "*.circles")


def _read(path: Path) -> tuple[Table, Floats]:
    """Return the validated circles, and dX, dY, dPhi of each step."""
    rows, steps = NumberRows(path, len(_COLUMNS)), NumberRows(path, 3)
    for number, line in numbered_lines(path):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        problem = None
        if cells[0] == "STEP":
            step = finite_numbers(cells[2:])
            if len(step) == 9 and max(map(abs, step[:3])) <= MAX_COORDINATE_M:
                steps.add(step[:3], number)
            else:
                problem = f"expected finite numbers: {STEP}"
        elif cells[0] not in _WORDS:
            problem = f"begins with neither STEP nor {_WORDS[1]}"
        elif len(circle := finite_numbers(cells[1:])) < 7:
            problem = f"expected finite numbers: {LANDMARK}"
        elif not len(steps.lines):
            problem = f"comes before the first step, expected {STEP}"
        else:
            only_id = circle[6] if len(circle) == 7 else -1.0
            rows.add([len(steps.lines) - 1.0, *circle[:2], only_id, *circle[3:6]], number)
        if problem:
            raise invalid(path, f"line {number}: {quoted(line)}: {problem}")
    if not len(rows.lines):
        raise invalid(path, f"holds no circle, expected lines {LANDMARK}")
    return checked_table(path, _COLUMNS, rows.values, rows.lines), steps.values
