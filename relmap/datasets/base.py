"""The common form of landmark logs, and the interface of readers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.shown import Brief

Log = TypeVar("Log", covariant=True)

MAX_ITERATION = 100_000_000
"""Upper limit of iteration numbers: no sensor log is that long."""


def common_range(begin: int, end: int, first: int, last: int) -> tuple[int, int]:
    """Return the part of ``range(begin, end)`` that a log covers; RelmapError if there is none."""
    if max(begin, first) >= min(end, last):
        raise RelmapError(f"scans {begin}:{end} are empty: the log covers {first}:{last}")
    return max(begin, first), min(end, last)


def some_of(log: Any, names: Iterable[str], rows: Ints | Bools | slice) -> dict[str, Any]:
    """Return some rows of those columns, named by `names`, that a log has."""
    columns = {name: getattr(log, name) for name in names}
    return {name: values[rows] for name, values in columns.items() if values is not None}


@dataclass(frozen=True, eq=False, repr=False)
class Scan(Brief):
    """The observations of one iteration.

    Attributes
    ----------
    iteration : int
        Number of the iteration in the log.
    points_robot : (n, 2) or (n, 3) float64, robot frame, metres
    ids : (n,) int64 or None
        Known association; negative for unidentified landmarks.
    rows : (n,) int64
        0-based rows of the log that contain the points.
    covariances : (n, d, d) float64 or None, robot frame, square metres
    odometry : (4, 4) float64 or None
        Motion since the previous iteration: the pose of the robot in its previous frame. NaN if
        unknown, None if the log has no odometry.
    """

    iteration: int
    points_robot: Floats
    ids: Ints | None
    rows: Ints
    covariances: Floats | None = None
    odometry: Floats | None = None


@dataclass(frozen=True, eq=False, repr=False)
class ObservationLog(Brief):
    """Landmark observations of a whole run, as a structure of arrays.

    Attributes
    ----------
    points_robot : (n, 2) or (n, 3) float64, robot frame, metres
        Two columns: a planar, 3-DoF world.
    iteration : (n,) int64, ascending
    rows : (n,) int64
        0-based rows of the source that contain the observations.
    first_iteration, end_iteration : int
        The log covers ``range(first_iteration, end_iteration)``; iterations without a row are
        empty.
    ids : (n,) int64 or None
        Known association; negative for unidentified landmarks.
    stamps_s : (end_iteration - first_iteration,) float64 or None
        Time of each iteration, seconds; None if the log has no clock.
    covariances : (n, d, d) float64 or None, robot frame, square metres
        Covariance of each observation; None if unknown.
    odometry : (end_iteration - first_iteration, 4, 4) float64 or None
        Motion from the previous iteration to each one, see `Scan`; that of the first is not used.
    no_odometry : str
        Why the log's odometry fields are not used as odometry, if so.
    names : tuple of str or None
        Original names of the ids 0, 1, ..., if the log has text ids.
    numbers : (end_iteration - first_iteration,) int64 or None
        Number of each iteration in the source, if they were renumbered in order of time.
    """

    points_robot: Floats
    iteration: Ints
    rows: Ints
    first_iteration: int
    end_iteration: int
    ids: Ints | None = None
    stamps_s: Floats | None = None
    covariances: Floats | None = None
    odometry: Floats | None = None
    no_odometry: str = ""
    names: tuple[str, ...] | None = None
    numbers: Ints | None = None

    @classmethod
    def of_scans(cls, points: Sequence[Floats], ids: Sequence[Ints]) -> ObservationLog:
        """Make the log of k scans in memory: the points (n, d) and the ids (n,) of each."""
        counts = [len(each) for each in points]
        iteration, rows = np.repeat(np.arange(len(counts)), counts), np.arange(sum(counts))
        known = np.concatenate(ids).astype(np.int64, copy=False)
        return cls(np.concatenate(points), iteration, rows, 0, len(counts), known)

    @property
    def dimension(self) -> int:
        """2 for a planar world, else 3."""
        return int(self.points_robot.shape[1])

    def __len__(self) -> int:
        """Return the number of iterations, empty ones included."""
        return self.end_iteration - self.first_iteration

    def scans(self) -> Iterator[Scan]:
        """Yield every iteration in order, the empty ones too."""
        numbers = np.arange(self.first_iteration, self.end_iteration + 1)
        offsets = np.searchsorted(self.iteration, numbers)
        for index in range(len(self)):
            rows = slice(offsets[index], offsets[index + 1])
            ids = None if self.ids is None else self.ids[rows]
            noise = None if self.covariances is None else self.covariances[rows]
            motion = None if self.odometry is None else self.odometry[index]
            points, number = self.points_robot[rows], int(numbers[index])
            yield Scan(number, points, ids, self.rows[rows], noise, motion)

    def between(self, begin: int, end: int) -> ObservationLog:
        """Return the part in iterations ``range(begin, end)``; RelmapError if it is empty."""
        first, last = common_range(begin, end, self.first_iteration, self.end_iteration)
        rows = slice(*np.searchsorted(self.iteration, [first, last]))
        steps = slice(first - self.first_iteration, last - self.first_iteration)
        by_iteration = some_of(self, ("stamps_s", "odometry", "numbers"), steps)
        return replace(self.only(rows), first_iteration=first, end_iteration=last, **by_iteration)

    def each_once(self) -> ObservationLog:
        """Return the log without points that repeat another one of their scan exactly."""
        table = np.column_stack([self.iteration, self.points_robot])
        order = np.lexsort(table.T)
        again = order[1:][(np.diff(table[order], axis=0) == 0).all(axis=1)]
        return self.only(np.delete(np.arange(len(table)), again)) if len(again) else self

    def only(self, rows: Ints | Bools | slice) -> ObservationLog:
        """Return the log with some of its rows, given by index or chosen (n,)."""
        columns = ("points_robot", "iteration", "rows", "ids", "covariances")
        return replace(self, **some_of(self, columns, rows))


class Dataset(Protocol[Log]):
    """One format of logs."""

    name: str
    """The format's name for ``--format``."""

    description: str
    """Description of its files, for messages."""

    def recognises(self, path: Path) -> bool:
        """Return whether the content of a file or folder has this format."""
        ...

    def load(self, path: Path) -> Log:
        """Read the log.

        `path`: a file or folder accepted by `recognises`. Raises `RelmapError` if the content
        violates the format: file, line, field.
        """
        ...
