"""Occupancy grids, read by the rules of a map server."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap.core.arrays import Ints
from relmap.core.errors import RelmapError
from relmap.exports.content import MapContent, read_content
from relmap.exports.grid import grid_of, pgm_bytes, yaml_text
from tests.everyformat import Mapped
from tests.exported import an_l, export, landmarks

pytestmark = pytest.mark.usefixtures("unrendered")

OCCUPIED, FREE, UNKNOWN = 100, 0, -1
"""Cells of an occupancy grid message."""


@dataclass(frozen=True, eq=False)
class ServedMap:
    """A map as a map server of ROS publishes it: row 0 is at the origin, rows go up."""

    cells: Ints
    resolution: float
    origin: tuple[float, float, float]

    def at(self, x: float, y: float) -> int:
        """Return the cell at a place in the frame of the map."""
        column = math.floor((x - self.origin[0]) / self.resolution)
        row = math.floor((y - self.origin[1]) / self.resolution)
        return int(self.cells[row, column])


def serve(about: Path) -> ServedMap:
    """Read a map by the rules that nav2's map_server documents for the trinary mode."""
    told = dict(line.split(": ", 1) for line in about.read_text().splitlines())
    assert set(told) >= {"image", "resolution", "origin", "negate", "occupied_thresh"}
    assert told["mode"] == "trinary"
    origin = [float(value) for value in told["origin"].strip("[]").split(",")]
    picture = (about.parent / told["image"].strip("'")).read_bytes()
    header = re.match(rb"P5\s+(\d+)\s+(\d+)\s+(\d+)\s", picture)
    width, height, depth = map(int, header.groups())
    pixels = np.frombuffer(picture[header.end() :], np.uint8).reshape(height, width)
    shade = pixels / depth
    occupied = shade if int(told["negate"]) else 1.0 - shade
    cells = np.full(pixels.shape, UNKNOWN)
    cells[occupied > float(told["occupied_thresh"])] = OCCUPIED
    cells[occupied < float(told["free_thresh"])] = FREE
    return ServedMap(cells[::-1], float(told["resolution"]), (origin[0], origin[1], origin[2]))


def served(folder: Path, content: MapContent, lines: Any, resolution_m: float = 0.1) -> ServedMap:
    grid = grid_of(content, lines, resolution_m)
    (folder / "map.pgm").write_bytes(pgm_bytes(grid))
    (folder / "map.yaml").write_text(yaml_text("map.pgm", grid))
    return serve(folder / "map.yaml")


def test_walls_are_occupied_and_cells_crossed_by_beams_are_free(tmp_path: Path) -> None:
    beams = np.array([[[1.05, 0.05]] * 2, [[4.0, 0.55], [1.05, -1.0]]])
    grid = served(tmp_path, an_l(), beams)
    assert grid.at(0.02, -1.0) == grid.at(3.9, -1.0) == OCCUPIED
    assert grid.at(4.0, 0.9) == grid.at(4.0, -0.5) == OCCUPIED
    assert grid.at(1.05, -0.5) == FREE  # under the robot, by the second beam
    assert grid.at(2.5, 0.28) == FREE  # on the first beam
    assert grid.at(1.05, 0.5) == grid.at(2.5, -0.5) == UNKNOWN
    assert grid.at(0.02, 0.9) == grid.at(-0.2, 0.5) == UNKNOWN
    assert (grid.cells == OCCUPIED).sum() == 41 + 20


def test_a_picture_shows_the_world_as_seen_from_above(tmp_path: Path) -> None:
    """The long wall is at the bottom of the picture, the short one to the right."""
    served(tmp_path, an_l(), None)
    picture = (tmp_path / "map.pgm").read_bytes()
    width, height = map(int, picture.split()[1:3])
    pixels = np.frombuffer(picture[-width * height :], np.uint8).reshape(height, width)
    rows, columns = np.nonzero(pixels == 0)
    (bottom,) = np.flatnonzero((pixels == 0).sum(axis=1) > 30)
    (right,) = np.flatnonzero((pixels == 0).sum(axis=0) > 15)
    assert (bottom, right) == (rows.max(), columns.max())
    assert set(np.unique(pixels)) == {0, 205}


def test_cells_passed_by_most_beams_are_free(tmp_path: Path) -> None:
    ends = np.array([[3.05, 0.05]] * 10)
    for stopped, cell in ((1, FREE), (2, FREE), (3, OCCUPIED), (10, OCCUPIED)):
        there = ends.copy()
        there[:stopped, 0] = 2.05
        begins = np.full((10, 2), 0.05)
        assert served(tmp_path, an_l(), (begins, there)).at(2.05, 0.05) == cell


@pytest.mark.parametrize("resolution_m", [0.05, 0.03, 0.25])
def test_beams_of_all_directions_end_in_their_cells(tmp_path: Path, resolution_m: float) -> None:
    """Each cell that a fine walk along a beam meets is counted, and no other."""
    rng = np.random.default_rng(3)
    begins, ends = rng.uniform([0.2, -0.8], [3.8, 0.8], (2, 60, 2))
    ends[0], ends[1] = begins[0] + [1.0, 0.0], begins[1] - [0.0, 0.3]
    for begin, end in zip(begins, ends, strict=True):
        grid = served(tmp_path, an_l(), (begin[None], end[None]), resolution_m)
        assert grid.at(*end) == OCCUPIED
        walk = begin + np.linspace(0, 1, 40000)[:, None] * (end - begin)
        met = np.floor((walk - grid.origin[:2]) / resolution_m).astype(int)
        cells = grid.cells.copy()
        assert (cells[met[:, 1], met[:, 0]] != UNKNOWN).all()
        cells[met[:, 1], met[:, 0]] = UNKNOWN
        assert (cells == FREE).sum() <= 1  # a corner of a cell that the walk stepped over


def test_a_stray_far_beam_does_not_blow_up_the_grid() -> None:
    ends = np.tile([[3.0, 0.5]], (5000, 1))
    ends[7] = [1e6, 0.0]
    grid = grid_of(an_l(), (np.zeros((5000, 2)), ends), 0.05)
    assert grid.pixels.shape[1] < 120


def test_grids_that_are_too_large_or_of_nothing_are_refused() -> None:
    content = an_l()
    content.result.poses[0, 0, 3] = 1e9
    with pytest.raises(RelmapError, match="give a coarser --resolution"):
        grid_of(content, None, 0.05)
    none = replace(content, walls=None, landmarks=landmarks([]))
    none = replace(none, result=replace(none.result, poses=np.empty((0, 4, 4))))
    with pytest.raises(RelmapError, match="the map is empty"):
        grid_of(none, None, 0.05)


@pytest.mark.parametrize("source", ["npz", "laser/a.scans.csv.gz", "clouds"])
def test_grid_of_walls_agrees_with_the_log(
    mapped: Mapped, logs: Path, tmp_path: Path, source: str
) -> None:
    """The beams that the result keeps, and those of the log, make free what the robot crossed."""
    result = mapped(source)
    export(result, "grid", tmp_path / "kept.yaml")
    export(result, "grid", tmp_path / "log.yaml", "--log", logs / source)
    kept, log = serve(tmp_path / "kept.yaml"), serve(tmp_path / "log.yaml")
    content = read_content(result)
    for x, y in (content.result.poses @ [0.5, 0.0, 0.0, 1.0])[:, :2].tolist():  # before the laser
        assert kept.at(x, y) == log.at(x, y) == FREE
    for (x0, y0), (x1, y1) in content.walls.ends.tolist():
        for part in np.linspace(0.01, 0.99, 50):
            assert kept.at(x0 + part * (x1 - x0), y0 + part * (y1 - y0)) == OCCUPIED
    if source != "clouds":  # of whose points the mapper keeps a part
        assert (kept.cells == log.cells).mean() > 0.999
    assert (kept.cells == FREE).mean() > 0.1


def test_without_beams_all_but_the_walls_is_unknown(
    mapped: Mapped, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for file in mapped("npz").iterdir():
        if file.name != "mapper.npz":
            (bare / file.name).write_bytes(file.read_bytes())
    export(bare, "grid", tmp_path / "grid")
    grid = serve(tmp_path / "grid" / "map.yaml")
    assert set(np.unique(grid.cells)) == {OCCUPIED, UNKNOWN}
    assert "all unknown except the map" in capsys.readouterr().out


@pytest.mark.parametrize("given", [True, False])
def test_grid_of_planar_points(mapped: Mapped, logs: Path, tmp_path: Path, given: bool) -> None:
    result = mapped("flat")
    export(result, "grid", tmp_path / "a.pgm", *(["--log", logs / "flat"] if given else []))
    grid, content = serve(tmp_path / "a.yaml"), read_content(result)
    places = content.landmarks.position[:, :2]
    assert all(grid.at(x, y) == OCCUPIED for x, y in places.tolist())
    begin = content.result.poses[0, :2, 3]
    for place in places:
        halfway = (begin + place) / 2
        if np.linalg.norm(places - halfway, axis=1).min() > 0.1:
            assert grid.at(*halfway) == FREE
