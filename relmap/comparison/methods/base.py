"""What every method that `relmap compare` runs offers, and what is told of it."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from relmap.core.landmarks import LandmarkMap
from relmap.datasets.scans import SensorView
from relmap.evaluation.sources import LogKind
from relmap.planes.table import PlaneTable

NO_MAP = LandmarkMap(np.empty(0, np.int64), np.empty((0, 3)))
NO_POSE = np.full((4, 4), np.nan)


@dataclass(frozen=True)
class Setup:
    """What a method is told before it begins.

    Attributes
    ----------
    dimension : int
        2 for a planar world, else 3.
    sigma_m : float
        Standard deviation of each observed coordinate, metres.
    range_m : float
        Distance of the farthest observation of the log, metres.
    sensor : SensorView
        What a log of point scans tells of its sensor.
    """

    dimension: int = 3
    sigma_m: float = 0.05
    range_m: float = 80.0
    sensor: SensorView = field(default_factory=SensorView)


class Method(Protocol):
    """One way to make a map or a path out of a log, scan by scan."""

    def update(
        self, points_robot: NDArray[np.float64], ids: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        """Take in one iteration.

        Parameters
        ----------
        points_robot : (n, 2) or (n, 3) float64, robot frame, metres
        ids : (n,) int64 or None
            Known association; negative where a landmark was not identified.

        Returns
        -------
        (n,) int64
            Label of the landmark of each observation; -1 where it has none.
        """
        ...

    def finish(self) -> None:
        """Do what is left to the end of the log."""
        return

    def landmarks_of(self, labels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return what landmarks (n,), labelled by earlier updates, are called now."""
        return labels

    @property
    def map(self) -> LandmarkMap:
        """The landmarks mapped so far; none where a method makes no map of landmarks."""
        return NO_MAP

    @property
    def planes(self) -> PlaneTable | None:
        """The walls; None where a method maps none."""
        return None

    @property
    def trajectory(self) -> NDArray[np.float64]:
        """``T_map_robot`` of every iteration so far, (k, 4, 4); NaN where there is none."""
        ...


@dataclass(frozen=True)
class MethodInfo:
    """A method and what must be known to choose it.

    Attributes
    ----------
    name : str
    about : str
        One line for the user.
    make : callable
        Makes a fresh one.
    logs : tuple of "landmarks", "scans"
        What it can be given.
    needs_ids : bool
        Whether it cannot find out which landmark is which.
    needs : str or None
        Module of the optional extra that it is made of.
    """

    name: str
    about: str
    make: Callable[[Setup], Method]
    logs: tuple[LogKind, ...] = ("landmarks",)
    needs_ids: bool = False
    needs: str | None = None

    @property
    def missing(self) -> str | None:
        """What must be installed before it can run; None where nothing is missing."""
        if self.needs is None or importlib.util.find_spec(self.needs) is not None:
            return None
        return f"{self.needs} is not installed: pip install 'relmap[peers]'"


class Poses:
    """The poses of a run, one for every iteration."""

    def __init__(self) -> None:
        self._poses: list[NDArray[np.float64]] = []

    def append(self, R: NDArray[np.float64], t: NDArray[np.float64]) -> None:
        """Add ``T_map_robot``: R (d, d), t (d,) metres; d is 2 or 3."""
        d = len(t)
        T_map_robot = np.eye(4)
        T_map_robot[:d, :d], T_map_robot[:d, 3] = R, t
        self._poses.append(T_map_robot)

    def append_none(self) -> None:
        """Add an iteration without a pose."""
        self._poses.append(NO_POSE)

    @property
    def values(self) -> NDArray[np.float64]:
        """All of them, (k, 4, 4)."""
        return np.array(self._poses).reshape(-1, 4, 4)


def identified(
    ids: NDArray[np.int64] | None, n: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return ids (n,), -1 where there is none, and which of the observations have one."""
    labels = np.full(n, -1, np.int64) if ids is None else np.where(ids >= 0, ids, -1)
    return labels, labels >= 0
