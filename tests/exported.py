"""Maps to be exported, and their export by the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relmap.cli import main
from relmap.core.landmarks import LandmarkTable
from relmap.exports.content import MapContent
from relmap.io.results import Result, Tracks
from relmap.planes.walls.table import PlaneTable


def landmarks(position: list[list[float]]) -> LandmarkTable:
    n = len(position)
    numbers, ones = np.arange(n), np.ones(n, dtype=np.int64)
    places = np.array(position).reshape(-1, 3)
    return LandmarkTable(
        numbers, places, np.full(n, np.nan), ones, numbers, numbers, ones, np.full(n, "static"),
        np.zeros(n, np.int64), -ones,
    )  # fmt: skip


def an_l(height: float = 0.0) -> MapContent:
    """An asymmetric world: a long wall along x at y = -1, a short one along y at x = 4."""
    ends = np.array([[[0.0, -1.0], [4.0, -1.0]], [[4.0, -1.0], [4.0, 1.0]]])
    numbers, corner = np.array([3, 7]), np.array([[-1, 5], [5, -1]])
    z = np.array([[0.0, height]] * 2)
    normal = np.array([[0.0, 1.0], [-1.0, 0.0]])
    seen, status = np.array([10, 20]), np.array(["static", "static"])
    walls = PlaneTable(numbers, ends, z, normal, corner, seen, numbers, seen, status)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0.5, 1.0, 1.5]
    nothing = np.empty(0, np.int64)
    table = landmarks([[4.0, -1.0, 0.0]])
    result = Result(
        table, Tracks(nothing, nothing, nothing), np.arange(3.0), poses, {"dimensions": 2}
    )
    return MapContent(Path("<a & b> $x$"), result, table, walls)


def export(result: Path, to: str, out: Path, *more: object) -> None:
    assert main(["export", str(result), "--to", to, "-o", str(out), *map(str, more)]) == 0
