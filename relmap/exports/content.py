"""The exported part of a result: mapped walls or landmarks, and the path."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from relmap.core.arrays import Bools, Floats
from relmap.core.landmarks import LandmarkTable
from relmap.io.results import MAP_PLY, Result
from relmap.planes.walls.files import PlaneResult, read_any
from relmap.planes.walls.table import PlaneTable
from relmap.plots.path import split_at_jumps

T = TypeVar("T", LandmarkTable, PlaneTable)


@dataclass(frozen=True, eq=False)
class MapContent:
    """The map of a result, without unmapped landmarks; map frame, metres.

    `folder`: the result folder. `result`: the result as read. `landmarks`: the mapped landmarks;
    for walls the corners. `walls`: the mapped walls; None for a map of points.
    """

    folder: Path
    result: Result
    landmarks: LandmarkTable
    walls: PlaneTable | None

    @property
    def path(self) -> list[Floats]:
        """The positions of the robot: pieces (k, 3), split where the path jumps."""
        pieces = split_at_jumps(self.result.poses[:, :3, 3])
        return [piece for piece in pieces if len(piece) > 1]

    @property
    def places(self) -> Floats:
        """All positions (n, 3) of landmarks, ends of walls and the path."""
        parts = [self.landmarks.position, self.result.poses[:, :3, 3]]
        if self.walls is not None:
            ends = self.walls.ends.reshape(-1, 2)
            parts.append(np.column_stack([ends, np.zeros(len(ends))]))
        return np.concatenate(parts)

    @property
    def description(self) -> str:
        """A short summary of the content."""
        n, poses = len(self.landmarks.landmark), len(self.result.poses)
        if self.walls is None:
            return f"{n} landmarks, a path of {poses} poses"
        return f"{len(self.walls.plane)} walls, {n} corners, a path of {poses} poses"


def read_content(folder: Path) -> MapContent:
    """Read the exported part of a result folder; RelmapError if it is not one of `relmap map`."""
    result = read_any(folder, f"exported; its mesh is {folder / MAP_PLY}")
    walls = None
    if isinstance(result, PlaneResult):
        walls = _rows(result.planes, np.isfinite(result.planes.ends[:, 0, 0]))
    return MapContent(folder, result, _rows(result.landmarks, result.mapped), walls)


def _rows(table: T, kept: Bools) -> T:
    return replace(table, **{name: column[kept] for name, column in vars(table).items()})
