"""Maps to be exported, and their export by the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.cli import main
from relmap.core.landmarks import LandmarkTable
from relmap.exports.content import MapContent
from relmap.io.results import Result
from tests.tables import NO_TRACKS, landmark_table, poses_along, wall_table


def landmarks(position: list[list[float]]) -> LandmarkTable:
    ones = np.ones(len(position), dtype=np.int64)
    return landmark_table(np.array(position).reshape(-1, 3), observations=ones)


def an_l(height: float = 0.0) -> MapContent:
    """An asymmetric world: a long wall along x at y = -1, a short one along y at x = 4."""
    ends = np.array([[[0.0, -1.0], [4.0, -1.0]], [[4.0, -1.0], [4.0, 1.0]]])
    numbers, corner = np.array([3, 7]), np.array([[-1, 5], [5, -1]])
    z, normal = np.array([[0.0, height]] * 2), np.array([[0.0, 1.0], [-1.0, 0.0]])
    about = {"z_extent": z, "normal": normal, "corner": corner, "plane": numbers}
    seen = {"observations": np.array([10, 20]), "first_iteration": numbers}
    walls = wall_table(ends, **about, **seen, last_iteration=seen["observations"])
    poses, table = poses_along([0.5, 1.0, 1.5]), landmarks([[4.0, -1.0, 0.0]])
    result = Result(table, NO_TRACKS, np.arange(3.0), poses, {"dimensions": 2})
    return MapContent(Path("<a & b> $x$"), result, table, walls)


def export(result: Path, to: str, out: Path, *more: object) -> None:
    assert main(["export", str(result), "--to", to, "-o", str(out), *map(str, more)]) == 0
