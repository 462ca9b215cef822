"""Maps for other programs, each read by rules or a library that are not relmap's."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap.cli import main
from relmap.core.arrays import Floats
from relmap.exports.content import read_content
from relmap.exports.drawings import dxf_text, svg_text
from relmap.exports.formats import FORMATS
from tests.commands import load, snapshot, table
from tests.everyformat import Mapped
from tests.exported import an_l, export

pytestmark = pytest.mark.usefixtures("unrendered")


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
    root = ET.fromstring(svg_text(an_l()))
    name = "{http://www.w3.org/2000/svg}"
    assert root.find(f"{name}title").text == "<a & b> $x$"
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
    read = load(tmp_path / "walls.geojson")
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
    read = load(tmp_path / "points.json")
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


def planar(x: float, y: float, yaw: float) -> Floats:
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


def test_only_what_was_written_is_reported(
    mapped: Mapped, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walls, points = mapped("npz"), mapped("flat")
    static = [row for row in table(walls / "planes.csv") if row["status"] == "static"]
    for to, result, said in (
        ("g2o", walls, "16 poses\n"),
        ("g2o", points, "12 landmarks, a path of 30 poses, 360 observations computed from"),
        ("ply", walls, f"{len(static)} walls\n"),
        ("ply", points, "12 landmarks\n"),
    ):
        capsys.readouterr()
        export(result, to, tmp_path / f"a.{to}")
        assert f"a.{to}: {said}" in capsys.readouterr().out


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
    assert len(mesh.triangles) == 2 * len(walls.plane)


@pytest.mark.parametrize("to", FORMATS)
def test_a_folder_or_a_file_and_the_same_bytes_again(
    mapped: Mapped, tmp_path: Path, to: str
) -> None:
    result, ending = mapped("npz"), FORMATS[to][0][0]
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
        ("out --to png -o a.png", "value for '--to': 'png' is not one of 'grid', 'dxf'"),
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
    assert re.search(r"the first at \d+ s; give log\.csv$", said)


@pytest.mark.parametrize(
    ("source", "header", "change", "said"),
    [
        ("flat", "iteration,x,y", lambda rows: rows[:, :3] * [1, 1, -1], "its points, .* off"),
        ("flat", "iteration,x,y,z", lambda rows: rows, "the map is planar, the log in space"),
        ("flat", "iteration,x,y", lambda rows: rows[1:, :3], "its row .* is not of iteration"),
        ("npz", "", lambda points: points * [1, -1], "its beams pass through .* of the walls"),
    ],
    ids=["mirrored", "in space", "fewer rows", "mirrored beams"],
)
def test_another_log_with_the_times_of_the_mapped_one_is_refused(
    mapped: Mapped,
    logs: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    source: str,
    header: str,
    change: Any,
    said: str,
) -> None:
    log, result, other = (
        logs / source,
        mapped(source),
        tmp_path / f"other.{'csv' if header else 'npz'}",
    )
    if header:
        rows = change(np.loadtxt(log / "observations.csv", delimiter=",", skiprows=1))
        np.savetxt(other, rows, "%.9g", ",", header=header, comments="")
    else:
        with np.load(log / "scans.npz") as scans:
            np.savez(other, **{**scans, "points": change(scans["points"])})
    capsys.readouterr()
    grid = ["export", str(result), "--to", "grid", "-o", str(tmp_path / "a.yaml")]
    assert main([*grid, "--log", str(other)]) == 2
    printed = capsys.readouterr().err
    assert re.search(f"the log is not the one that was mapped: {said}.*; give ", printed)
    assert len(printed.splitlines()) == 1
