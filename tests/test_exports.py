"""Maps for other programs, each read by rules or a library that are not relmap's."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from relmap.cli import main
from relmap.core.errors import RelmapError
from relmap.core.landmarks import LandmarkTable
from relmap.exports.content import MapContent, read_content
from relmap.exports.drawings import dxf_text, svg_text
from relmap.exports.formats import FORMATS
from relmap.exports.grid import grid_of, pgm_bytes, yaml_text
from relmap.io.results import Result, Tracks
from relmap.planes.table import PlaneTable
from tests.commands import snapshot, table
from tests.everyformat import Mapped

OCCUPIED, FREE, UNKNOWN = 100, 0, -1
"""Cells of an occupancy grid message."""


@dataclass(frozen=True, eq=False)
class ServedMap:
    """A map as a map server of ROS publishes it: row 0 is at the origin, rows go up."""

    cells: NDArray[np.int64]
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
    assert header is not None
    width, height, depth = map(int, header.groups())
    pixels = np.frombuffer(picture[header.end() :], np.uint8).reshape(height, width)
    shade = pixels / depth
    occupied = shade if int(told["negate"]) else 1.0 - shade
    cells = np.full(pixels.shape, UNKNOWN)
    cells[occupied > float(told["occupied_thresh"])] = OCCUPIED
    cells[occupied < float(told["free_thresh"])] = FREE
    return ServedMap(cells[::-1], float(told["resolution"]), (origin[0], origin[1], origin[2]))


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
    return MapContent(result, table, walls)


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
        met = np.unique(met, axis=0)
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


def export(result: Path, to: str, out: Path, *more: object) -> None:
    assert main(["export", str(result), "--to", to, "-o", str(out), *map(str, more)]) == 0


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
    assert content.walls is not None
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


def test_dxf_is_valid_and_has_the_right_positions(mapped: Mapped, tmp_path: Path) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    for source in ("npz", "csv/observations.csv"):
        export(mapped(source), "dxf", tmp_path / "plan.dxf")
        drawing = ezdxf.readfile(tmp_path / "plan.dxf")
        audit = drawing.audit()
        assert (drawing.dxfversion, len(audit.errors), len(audit.fixes)) == ("AC1009", 0, 0)
        content, space = read_content(mapped(source)), drawing.modelspace()
        dots = [tuple(point.dxf.location) for point in space.query("POINT")]
        assert dots == [tuple(place) for place in content.landmarks.position.tolist()]
        drawn = [[tuple(line.dxf.start), tuple(line.dxf.end)] for line in space.query("LINE")]
        walls = [] if content.walls is None else content.walls.ends.tolist()
        assert [[a[:2], b[:2]] for a, b in drawn] == [[tuple(a), tuple(b)] for a, b in walls]
        (path,) = space.query("POLYLINE")
        assert [tuple(v) for v in path.points()] == [
            tuple(place) for place in content.result.poses[:, :3, 3].tolist()
        ]


def test_dxf_has_walls_as_high_as_they_are() -> None:
    ezdxf = pytest.importorskip("ezdxf")
    from io import StringIO

    drawing = ezdxf.read(StringIO(dxf_text(an_l(2.5))))
    assert [line.dxf.thickness for line in drawing.modelspace().query("LINE")] == [2.5, 2.5]


def test_svg_shows_y_upwards_and_names_are_text() -> None:
    root = ET.fromstring(svg_text(an_l(), "<a & b> $x$"))
    name = "{http://www.w3.org/2000/svg}"
    assert root.find(f"{name}title").text == "<a & b> $x$"  # type: ignore[union-attr]
    long, short = ({k: float(v) for k, v in line.attrib.items() if k[0] in "xy"}
                   for line in root.iter(f"{name}line"))  # fmt: skip
    assert (long["x1"], long["y1"], long["x2"], long["y2"]) == (0.0, 1.0, 4.0, 1.0)
    assert (short["x1"], short["y1"], short["x2"], short["y2"]) == (4.0, 1.0, 4.0, -1.0)
    left, top, wide, tall = map(float, root.attrib["viewBox"].split())
    assert left < 0.0 < 4.0 < left + wide
    assert top < -1.0 < 1.0 < top + tall


def test_geojson_agrees_with_the_tables(mapped: Mapped, tmp_path: Path) -> None:
    result = mapped("npz")
    export(result, "geojson", tmp_path / "walls.geojson")
    read = json.loads((tmp_path / "walls.geojson").read_text())
    assert read["type"] == "FeatureCollection"
    assert "metres" in read["frame"]
    assert "crs" not in read
    walls = [f for f in read["features"] if f["properties"]["kind"] == "wall"]
    rows = [row for row in table(result / "planes.csv") if row["x0"]]
    assert len(walls) == len(rows) > 2
    for wall, row in zip(walls, rows, strict=True):
        assert wall["geometry"]["type"] == "LineString"
        (x0, y0), (x1, y1) = wall["geometry"]["coordinates"]
        assert [x0, y0, x1, y1] == [float(row[name]) for name in ("x0", "y0", "x1", "y1")]
        told = wall["properties"]
        assert (told["end0"], told["end1"], told["status"]) == (
            row["end0"], row["end1"], row["status"],
        )  # fmt: skip
        assert told["observations"] == int(row["observations"])
    export(mapped("csv/observations.csv"), "geojson", tmp_path / "points.json")
    read = json.loads((tmp_path / "points.json").read_text())
    kinds = [f["geometry"]["type"] for f in read["features"]]
    assert kinds.count("Point") == 12
    assert all(len(f["geometry"]["coordinates"]) == 3 for f in read["features"][:12])


def rows_of(path: Path) -> dict[str, list[list[float]]]:
    """Read a g2o file: numbers by tag."""
    rows: dict[str, list[list[float]]] = {}
    for line in path.read_text().splitlines():
        tag, *values = line.split()
        rows.setdefault(tag, []).append([float(value) for value in values])
    return rows


def planar(x: float, y: float, yaw: float) -> NDArray[np.float64]:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


@pytest.mark.parametrize("given", [True, False])
def test_g2o_of_planar_points(mapped: Mapped, logs: Path, tmp_path: Path, given: bool) -> None:
    more = ["--log", logs / "flat"] if given else []
    export(mapped("flat"), "g2o", tmp_path / "a.g2o", *more)
    rows = rows_of(tmp_path / "a.g2o")
    assert {tag: len(found) for tag, found in rows.items()} == {
        "VERTEX_SE2": 30, "VERTEX_XY": 12, "EDGE_SE2": 29, "EDGE_SE2_XY": 360,
    }  # fmt: skip
    poses = {int(k): planar(*pose) for k, *pose in rows["VERTEX_SE2"]}
    places = {int(k): place for k, *place in rows["VERTEX_XY"]}
    assert not set(poses) & set(places)
    for a, b, *values in rows["EDGE_SE2"]:
        np.testing.assert_allclose(poses[int(a)] @ planar(*values[:3]), poses[int(b)], atol=1e-9)
        assert values[3:] == [1, 0, 0, 1, 0, 1]
    off = []
    for a, b, x, y, *information in rows["EDGE_SE2_XY"]:
        off.append((poses[int(a)] @ [x, y, 1])[:2] - places[int(b)])
        assert information[1] == 0
        assert information[0] == information[2]
    rms = float(np.sqrt(np.mean(np.square(off))))
    assert (0.005 < rms < 0.02) if given else rms < 1e-9
    weight = rows["EDGE_SE2_XY"][0][4]
    assert (4000 < weight < 30000) if given else weight == 1  # noise of 0.01 m


def test_g2o_of_points_in_space(mapped: Mapped, logs: Path, tmp_path: Path) -> None:
    source = "csv/observations.csv"
    export(mapped(source), "g2o", tmp_path / "a.g2o", "--log", logs / source)
    rows = rows_of(tmp_path / "a.g2o")
    assert len(rows["VERTEX_SE3:QUAT"]) == 30
    assert all(len(edge) == 2 + 7 + 21 for edge in rows["EDGE_SE3:QUAT"])
    assert all(len(edge) == 3 + 3 + 6 for edge in rows["EDGE_SE3_TRACKXYZ"])
    assert {edge[2] for edge in rows["EDGE_SE3_TRACKXYZ"]} == {rows["PARAMS_SE3OFFSET"][0][0]}


def test_g2o_of_walls_is_a_pose_graph(mapped: Mapped, tmp_path: Path) -> None:
    export(mapped("npz"), "g2o", tmp_path / "a.g2o")
    rows = rows_of(tmp_path / "a.g2o")
    assert set(rows) == {"VERTEX_SE2", "EDGE_SE2"}
    assert len(rows["EDGE_SE2"]) == len(rows["VERTEX_SE2"]) - 1 == 15


def test_ply_is_read_by_plyfile(mapped: Mapped, tmp_path: Path) -> None:
    plyfile = pytest.importorskip("plyfile")
    for source in ("npz", "clouds", "csv/observations.csv"):
        export(mapped(source), "ply", tmp_path / "a.ply")
        read, content = plyfile.PlyData.read(tmp_path / "a.ply"), read_content(mapped(source))
        xyz = np.column_stack([read["vertex"][axis] for axis in "xyz"])
        if content.walls is None:
            np.testing.assert_array_equal(xyz, content.landmarks.position)
            continue
        edges = np.column_stack([read["edge"]["vertex1"], read["edge"]["vertex2"]])
        np.testing.assert_array_equal(xyz[edges][:, :, :2], content.walls.ends)
        high = content.walls.z_extent[:, 1] > content.walls.z_extent[:, 0]
        assert high.all() == (source == "clouds")
        if not high.any():
            continue
        for corners, normal in zip(
            read["face"]["vertex_indices"], content.walls.normal[high], strict=True
        ):
            a, b, c, d = xyz[corners]
            front = np.cross(b - a, c - b)
            assert front[:2] @ normal > 0.99 * np.linalg.norm(front) > 0
            np.testing.assert_allclose(np.cross(d - c, a - d), front, atol=1e-9)


def test_open3d_reads_ply(mapped: Mapped, tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    export(mapped("clouds"), "ply", tmp_path / "a.ply")
    mesh = open3d.io.read_triangle_mesh(str(tmp_path / "a.ply"))
    walls = read_content(mapped("clouds")).walls
    assert walls is not None
    assert len(mesh.triangles) == 2 * len(walls.plane)


@pytest.mark.parametrize("to", FORMATS)
def test_a_folder_or_a_file_and_the_same_bytes_again(
    mapped: Mapped, tmp_path: Path, to: str
) -> None:
    result, ending = mapped("npz"), FORMATS[to].endings[0]
    export(result, to, tmp_path / "new" / "folder")
    export(result, to, tmp_path / "new" / "folder")
    export(result, to, tmp_path / f"map{ending}")
    files = snapshot(tmp_path / "new" / "folder")
    assert f"map{ending}" in files
    for name, content in files.items():
        assert (tmp_path / name).read_bytes() == content


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("out --to grid -o a.yaml", "planar and this map is of points in space: export it to ply"),
        ("out --to grid -o a.yaml --resolution 0", "must be 0.001 to 100 metres"),
        ("out --to grid -o a.yaml --resolution nan", "must be 0.001 to 100 metres"),
        ("out --to dxf -o a.svg", "--to dxf writes .dxf, and a.svg ends otherwise"),
        ("out --to dxf -o a.dxf --resolution 0.1", "--resolution is for --to grid"),
        ("out --to ply -o a.ply --log log.csv", "--log is for --to grid and g2o"),
        ("out --to png -o a.png", "'png' is not one of 'grid', 'dxf'"),
        ("truth --to dxf -o a.dxf", "truth is not a result folder"),
        ("gone --to dxf -o new/a", "gone is not a result folder"),
        ("out --to g2o -o new/a.g2o --log gone.csv", "gone.csv"),
        ("out --to dxf -o log.csv/a.dxf", "cannot write"),
    ],
)
def test_what_cannot_be_exported_is_reported_in_one_line(
    place: Path, refused: Any, arguments: str, said: str
) -> None:
    assert said in refused("export", *arguments.split())


def test_a_log_that_was_not_mapped_is_refused(place: Path, refused: Any) -> None:
    lines = (place / "log.csv").read_text().splitlines()
    (place / "short.csv").write_text("\n".join(lines[:-20]) + "\n")
    said = refused("export", "out", "--to", "g2o", "-o", "a.g2o", "--log", "short.csv")
    assert "the log is not the one that was mapped: 5 poses" in said
