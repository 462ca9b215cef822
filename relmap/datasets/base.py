"""What every landmark log looks like once read, and what a format's reader offers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError

Log = TypeVar("Log", covariant=True)

MAX_ITERATION = 100_000_000
"""Iteration numbers above this are taken for damage: no sensor log is that long."""


def common_range(begin: int, end: int, first: int, last: int) -> tuple[int, int]:
    """Return the part of iterations ``range(begin, end)`` that a log from first to last holds.

    Raises
    ------
    RelmapError
        If there is none.
    """
    if max(begin, first) >= min(end, last):
        raise RelmapError(f"scans {begin}:{end} hold nothing: the log covers {first}:{last}")
    return max(begin, first), min(end, last)


@dataclass(frozen=True, eq=False)
class Scan:
    """The observations of one iteration.

    Attributes
    ----------
    iteration : int
        Number of the iteration in the log.
    points_robot : (n, 2) or (n, 3) float64, robot frame, metres
    ids : (n,) int64 or None
        Known association; negative where a landmark was not identified.
    rows : (n,) int64
        0-based rows of the log that hold the points.
    covariances : (n, d, d) float64 or None, robot frame, square metres
    odometry : (4, 4) float64 or None
        Motion since the iteration before: the pose of the robot in its frame there. NaN where it is
        not known, None where the log has no odometry.
    """

    iteration: int
    points_robot: Floats
    ids: Ints | None
    rows: Ints
    covariances: Floats | None = None
    odometry: Floats | None = None


@dataclass(frozen=True, eq=False)
class ObservationLog:
    """Landmark observations of a whole run, as a structure of arrays.

    Attributes
    ----------
    points_robot : (n, 2) or (n, 3) float64, robot frame, metres
        Two columns: a planar, 3-DoF world.
    iteration : (n,) int64, ascending
    rows : (n,) int64
        0-based rows of the source that hold the observations.
    first_iteration, end_iteration : int
        The log covers ``range(first_iteration, end_iteration)``; iterations without a row saw
        nothing.
    ids : (n,) int64 or None
        Known association; negative where a landmark was not identified.
    stamps_s : (end_iteration - first_iteration,) float64 or None
        Time of each iteration, seconds; None if the log has no clock.
    covariances : (n, d, d) float64 or None, robot frame, square metres
        How noisy each observation is; None if the log does not tell.
    odometry : (end_iteration - first_iteration, 4, 4) float64 or None
        Motion to each iteration from the one before, see `Scan`; that of the first is not used.
    no_odometry : str
        Why poses that stand in the log where odometry would are not taken for it, if so.
    names : tuple of str or None
        What the ids 0, 1 and so on stand for, where the log has texts for ids.
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
        """Return the part of the log in iterations ``range(begin, end)``.

        Parameters
        ----------
        begin, end : int
            In the log's own numbers; the log may end before.

        Raises
        ------
        RelmapError
            If the log has no iteration in that range.
        """
        first, last = common_range(begin, end, self.first_iteration, self.end_iteration)
        rows = slice(*np.searchsorted(self.iteration, [first, last]))
        steps = slice(first - self.first_iteration, last - self.first_iteration)
        return replace(
            self,
            points_robot=self.points_robot[rows],
            iteration=self.iteration[rows],
            rows=self.rows[rows],
            first_iteration=first,
            end_iteration=last,
            ids=None if self.ids is None else self.ids[rows],
            stamps_s=None if self.stamps_s is None else self.stamps_s[steps],
            covariances=None if self.covariances is None else self.covariances[rows],
            odometry=None if self.odometry is None else self.odometry[steps],
        )


class Dataset(Protocol[Log]):
    """One format of logs."""

    name: str
    """The format's name, as ``--format`` takes it."""

    description: str
    """What its files look like, for messages."""

    def recognises(self, path: Path) -> bool:
        """Tell from its content whether a file or folder is of this format.

        Parameters
        ----------
        path : Path
        """
        ...

    def load(self, path: Path) -> Log:
        """Read the log.

        Parameters
        ----------
        path : Path
            A file or folder that `recognises` knows.

        Raises
        ------
        RelmapError
            If the content is not what the format promises: file, line, field.
        """
        ...
