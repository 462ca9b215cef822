"""Logs of point scans: read, recognised, refused."""

from __future__ import annotations

import gzip
import lzma
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from relmap.core.errors import RelmapError
from relmap.datasets import (
    SCAN_DATASETS,
    SCAN_FORMATS,
    ScanLog,
    open_log,
    open_scans,
    read_relations,
    write_scans_npz,
)
from tests.logs import put

ZEROS = "0 0 0 0 0"
GRAPH = (
    "VERTEX2 0 7 8 0.5\n"
    f"ROBOTLASER1 0 -1.5 3 0.5 50 0.1 0 3 1 2 60 0 0.2 0 0 0 0 0 {ZEROS} 10.5 host 0.1\n"
    "VERTEX2 1 8 8 0.5\nEDGE2 0 1 1 0 0 1 0 1 1 0 0\n"
    "ROBOTLASER1 0 -1.5 3 0.5 50 0.1 0 3 1 0 49 2 .5 .5 2 1 1.5 2 1 1.5707963267948966 "
    f"{ZEROS} 11.5 host 0.2\n"
)
CORRECTED = (
    "# message formats defined: PARAM FLASER\nPARAM robot_use_laser on nohost 0\n"
    "ODOM 0 0 0 0 0 0 1 host 1\n"
    "FLASER 2 3.5 81.91 1 2 0.5 1 2 0.5 4.5 host 9\n"
    "NEFF 12\n"
    "FLASER 3 1 2 81.8 1 2 0.5 1 2 0.5 5.5 host 9\n"
)
LASER_COMMENT = "# sensor on robot x=0.2 y=0 z=0.1 yaw=0 ; 3 beams, max range 80 m\n"
LASER_HEADER = "t_s,gt_x,gt_y,gt_theta,odo_dx,odo_dy,odo_dtheta,r0,r1,r2\n"
LASER = f"{LASER_COMMENT}{LASER_HEADER}10,1,2,0.5,0,0,0,1,2,3\n11,2,2,0.5,0,0,0,1,80,3\n"
CLOUD = np.array([[1.0, 2, 3], [4, 5, 6], [np.nan, 0, 0], [7, 8, 9]])


def failure(path: Path, format: str | None = None) -> str:
    """Return the one line with which a log is refused, at the latest when its scans are read."""
    with pytest.raises(RelmapError) as caught:
        list(open_scans(path, format).scans())
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 600
    return message


def points_of(log: ScanLog) -> list[list[list[float]]]:
    return [scan.points_robot.round(12).tolist() for scan in log.scans()]


def pcd(points: NDArray[np.float64], declared: int | None = None) -> bytes:
    n = len(points) if declared is None else declared
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\n"
        f"TYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {n}\nDATA binary\n"
    )
    return header.encode() + points.astype("<f4").tobytes()


def ply(points: NDArray[np.float64], declared: int | None = None) -> bytes:
    n = len(points) if declared is None else declared
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    return f"ply\nformat ascii 1.0\nelement vertex {n}\n{axes}end_header\n{rows}".encode()


def npz(path: Path, **changes: object) -> Path:
    """Write a log of two scans with some arrays changed, or left out where None."""
    arrays: dict[str, object] = {
        "points": np.arange(9.0).reshape(3, 3),
        "iteration": np.array([0, 0, 1]),
        "stamps_s": np.array([0.5, 1.5]),
    }
    kept = {name: value for name, value in (arrays | changes).items() if value is not None}
    np.savez(path, **kept)  # type: ignore[arg-type]
    return path


def test_formats_are_named() -> None:
    assert SCAN_FORMATS == ("scans-npz", "carmen-log", "mrpt-laser2d", "point-clouds")
    assert len({dataset.description for dataset in SCAN_DATASETS}) == len(SCAN_DATASETS)


# ---------------------------------------------------------------------------- scans.npz


@given(
    counts=st.lists(st.integers(0, 4), min_size=1, max_size=6).filter(any),
    columns=st.sampled_from([2, 3]),
    seed=st.integers(0, 99),
)
def test_what_is_written_reads_back_bit_by_bit(
    folder: Path, counts: list[int], columns: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    scans = [rng.normal(size=(count, columns)) for count in counts]
    stamps_s = np.cumsum(rng.uniform(0.1, 1, len(counts)))
    write_scans_npz(folder / "scans.npz", scans, stamps_s)
    for path in (folder / "scans.npz", folder):
        log = open_scans(path)
        assert log.dimension == columns
        assert len(log) == len(counts)
        for number, scan in enumerate(log.scans()):
            assert scan.iteration == number
            assert scan.points_robot.tobytes() == scans[number].tobytes()
            assert scan.stamp_s == stamps_s[number]
            assert scan.T_reference_robot is None
    assert [path.name for path in folder.iterdir()] == ["scans.npz"]


def test_rows_may_come_in_any_order_and_as_float32(tmp_path: Path) -> None:
    points = np.arange(9, dtype=np.float32).reshape(3, 3)
    path = npz(tmp_path / "a.npz", points=points, iteration=np.array([1, 0, 1]))
    assert points_of(open_scans(path)) == [[[3, 4, 5]], [[0, 1, 2], [6, 7, 8]]]
    assert open_scans(path).points_of(0).dtype == np.float64


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"points": None}, "points is not a file in the archive"),
        ({"stamps_s": None}, "stamps_s is not a file"),
        ({"points": np.zeros((3, 4))}, r"array points: float64 \(3, 4\)"),
        ({"points": np.zeros((0, 3)), "iteration": np.zeros(0, int)}, "at least one point"),
        ({"points": np.array(3.0)}, "array points"),
        ({"points": np.zeros((3, 3), dtype=complex)}, "array points: complex"),
        ({"points": np.array([[0, 0, 0], [0, np.nan, 0], [0, 0, 0]])}, "points, row 1: is not fin"),
        ({"points": np.full((3, 3), 1e12)}, "row 0: is not finite or out of range"),
        ({"iteration": np.zeros(3)}, "array iteration: float64"),
        ({"iteration": np.zeros(2, int)}, r"array iteration: int64 \(2,\)"),
        ({"iteration": np.array([0, 1, 2])}, "iteration, row 2: is no scan, expected 0 to 1"),
        ({"iteration": np.array([0, -1, 1])}, "iteration, row 1"),
        ({"stamps_s": np.array([1.0, 1.0])}, "stamps_s, row 1: is no later time"),
        ({"stamps_s": np.array([np.nan, 1.0])}, "stamps_s, row 0"),
        ({"stamps_s": np.zeros((2, 1))}, "array stamps_s"),
        ({"stamps_s": np.array([object(), 1], dtype=object)}, "allow_pickle"),
    ],
)
def test_damaged_arrays(tmp_path: Path, changes: dict[str, object], expected: str) -> None:
    with pytest.raises(RelmapError, match=expected):
        open_scans(npz(tmp_path / "scans.npz", **changes))


def test_cut_short_or_foreign_npz(tmp_path: Path) -> None:
    whole = npz(tmp_path / "scans.npz").read_bytes()
    for size in (4, 30, len(whole) // 2, len(whole) - 1):
        cut = tmp_path / "cut.npz"
        cut.write_bytes(whole[:size])
        assert "cut.npz: cannot be read" in failure(cut)
    flipped = bytearray(whole)
    flipped[200] ^= 0xFF
    (tmp_path / "cut.npz").write_bytes(flipped)
    assert "cut.npz: cannot be read" in failure(tmp_path / "cut.npz")
    assert "cannot be read" in failure(put(tmp_path, "text\n", "text.npz"), "scans-npz")
    (tmp_path / "scans.npz").unlink()
    assert "does not exist" in failure(tmp_path, "scans-npz")


# ---------------------------------------------------------------------------- CARMEN


def test_corrected_log(tmp_path: Path) -> None:
    log = open_scans(put(tmp_path, CORRECTED, "a.log"))
    assert log.dimension == 2
    assert log.stamps_s.tolist() == [4.5, 5.5]
    # Two beams of a half turn that leaves out its last one, three of a whole one; 81.8 is none.
    assert points_of(log) == [[[0, -3.5]], [[0, -1], [2, 0]]]
    assert log.poses is not None
    np.testing.assert_allclose(log.poses[0, :2, 3], [1, 2])
    np.testing.assert_allclose(log.poses[0, :2, 0], [np.cos(0.5), np.sin(0.5)])


def test_full_scale_counts_only_where_it_is_reached(tmp_path: Path) -> None:
    text = CORRECTED.replace("81.91", "70")
    assert points_of(open_scans(put(tmp_path, text.replace("81.8", "60"), "a.log")))[1][2] == [
        0,
        60,
    ]
    assert len(points_of(open_scans(put(tmp_path, text, "a.log")))[1]) == 2


def test_graph_log(tmp_path: Path) -> None:
    path = tmp_path / "a.log.gz"
    path.write_bytes(gzip.compress(GRAPH.encode()))
    log = open_scans(path)
    assert log.stamps_s.tolist() == [10.5, 11.5]
    first, second = (scan.points_robot for scan in log.scans())
    bearing = np.array([-1.5, -1.0])
    expected = np.array([1.0, 2.0])[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    np.testing.assert_allclose(first, expected + np.array([0.2, 0]))
    # The laser stands where the robot does, turned a little to the right; 0 is no return.
    bearing = np.array([-1.5, -0.5]) + 1.5 - np.pi / 2
    expected = np.array([1.0, 49.0])[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    np.testing.assert_allclose(second, expected, atol=1e-12)
    assert log.poses is not None
    np.testing.assert_allclose(log.poses[:, 0, 3], [7, 8])


def test_a_log_without_vertices_gives_the_pose_of_its_scans(tmp_path: Path) -> None:
    text = "\n".join(line for line in GRAPH.splitlines() if line.startswith("ROBOT"))
    log = open_scans(put(tmp_path, text, "a.log"))
    assert log.poses is not None
    np.testing.assert_allclose(log.poses[:, 0, 3], [0, 2])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("3.5 81.91 1", "3.5 1", "line 4: 'FLASER 2 3.5 1 2 0.5 1 2', expected FLASER n r1"),
        ("3.5", "nan", "line 4"),
        ("3.5", "inf", "line 4"),
        ("3.5", "3_5", "line 4: '3_5', expected FLASER"),
        ("3.5", "x", "line 4"),
        ("3.5", "-1", "line 4: the range of beam 0 is -1, expected metres"),
        ("3.5", "1e10", "line 4: the range of beam 0"),
        ("FLASER 2", "FLASER 0", "line 4"),
        ("FLASER 2", "FLASER -2", "line 4"),
        ("FLASER 2", "FLASER 99999", "line 4"),
        ("FLASER 2", "FLASER \u0662", "line 4"),
        ("5.5 host 9\n", "5.5 ho", "line 6"),
        ("5.5 host", "4.4 host", "line 6, field t: time 4.4 after 4.5, expected seconds in asc"),
        ("FLASER", "RLASER", "holds no scan, expected a CARMEN log"),
    ],
)
def test_damaged_carmen_log(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in failure(put(tmp_path, CORRECTED.replace(old, new), "a.log"), "carmen-log")


@pytest.mark.parametrize(
    ("old", "new"),
    [("0 3 1 2 60 0", "0 3 1 2 60 1"), ("0 3 1 2 60 0", "0 3 1 2"), ("-1.5 3", "- 3")],
)
def test_damaged_graph_log(tmp_path: Path, old: str, new: str) -> None:
    message = failure(put(tmp_path, GRAPH.replace(old, new, 1), "a.log"))
    assert "line 2" in message
    assert "expected ROBOTLASER1" in message


def test_cut_gzip(tmp_path: Path) -> None:
    data = gzip.compress(GRAPH.encode() * 50)
    (tmp_path / "a.log.gz").write_bytes(data[: len(data) // 2])
    assert "damaged gzip" in failure(tmp_path / "a.log.gz", "carmen-log")


def test_a_clock_that_stands_still_counts_scans(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = put(tmp_path, CORRECTED.replace("5.5 host", "4.5 host"), "a.log")
    assert open_scans(path).stamps_s.tolist() == [0, 1]
    assert "times repeat" in caplog.text


# ---------------------------------------------------------------------------- MRPT's laser


def test_mrpt_laser(tmp_path: Path) -> None:
    path = put(tmp_path, LASER, "simul.scans.csv")
    for log in (open_scans(path), open_scans(tmp_path)):
        assert log.stamps_s.tolist() == [10, 11]
        assert points_of(log) == [[[0.2, -1], [2.2, 0], [0.2, 3]], [[0.2, -1], [0.2, 3]]]
        assert log.poses is not None
        np.testing.assert_allclose(log.poses[1, :2, 3], [2, 2])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (LASER_COMMENT, "", "no usable sensor"),
        ("x=0.2", "x=here", "no usable sensor"),
        ("max range 80", "max range -1", "no usable sensor"),
        ("gt_y,", "", "missing column gt_y"),
        ("r1", "r4", "unknown column 'r4'"),
        ("1,80,3", "1,80", "line 4: 9 fields"),
        ("1,80,3", "1,nan,3", "line 4, field r1: 'nan' is not finite"),
        ("1,80,3", "1,-1,3", "line 4, field r1"),
        ("11,2", "9,2", "line 4, field t_s: time 9.0 after 10.0"),
    ],
)
def test_damaged_mrpt_laser(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in failure(put(tmp_path, LASER.replace(old, new), "a.csv"), "mrpt-laser2d")


def test_messages_do_not_list_hundreds_of_beams(tmp_path: Path) -> None:
    beams = ",".join(f"r{k}" for k in range(361))
    path = put(tmp_path, f"{LASER_COMMENT}{LASER_HEADER.replace('r0,r1,r2', beams)}1,2\n", "a.csv")
    assert "expected 368: t_s,gt_x" in failure(path)


# ---------------------------------------------------------------------------- point clouds


@pytest.mark.parametrize("write", [pcd, ply])
@pytest.mark.parametrize("packed", [False, True])
def test_clouds_in_the_order_of_their_numbers(
    tmp_path: Path, write: type[bytes], packed: bool
) -> None:
    for number in (2, 10, 9):
        data = write(CLOUD * number)
        name = f"scan{number}.{write.__name__}" + ".xz" * packed
        (tmp_path / name).write_bytes(lzma.compress(data) if packed else data)
    log = open_scans(tmp_path)
    assert log.dimension == 3
    assert log.stamps_s.tolist() == [0, 1, 2]
    expected = CLOUD[[0, 1, 3]]
    assert points_of(log) == [(expected * k).tolist() for k in (2, 9, 10)]
    assert points_of(open_scans(tmp_path / name)) == [(expected * 9).tolist()]
    part = log.between(1, 3)
    assert [scan.iteration for scan in part.scans()] == [1, 2]
    assert points_of(part) == points_of(log)[1:]


def test_poses_beside_the_clouds(tmp_path: Path) -> None:
    rows = []
    for number in range(3):
        matrix = np.eye(4)
        matrix[:3, 3], matrix[3, 3] = [number, 5, 6], 100 + number
        rows += [",".join(map(str, row)) + "," for row in matrix.tolist()]
    put(tmp_path, "\n".join(rows) + "\n", "alidarPose.csv")
    for number in (1, 2):
        (tmp_path / f"full{number}.pcd").write_bytes(pcd(CLOUD))
    log = open_scans(tmp_path)
    assert log.stamps_s.tolist() == [101, 102]
    assert log.poses is not None
    assert log.poses[:, :3, 3].tolist() == [[1, 5, 6], [2, 5, 6]]
    assert log.poses[:, 3].tolist() == [[0, 0, 0, 1]] * 2
    put(tmp_path, "\n".join(rows[:9]), "alidarPose.csv")
    assert "alidarPose.csv: no rows for full2.pcd" in failure(tmp_path)
    put(tmp_path, "\n".join(rows).replace("6.0,", "six,", 1), "alidarPose.csv")
    assert "alidarPose.csv: line 3" in failure(tmp_path)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        pytest.param(pcd(CLOUD)[:-5], "3 of 4 points", id="pcd cut"),
        pytest.param(pcd(CLOUD, 9), "4 of 9 points", id="pcd too short"),
        pytest.param(ply(CLOUD, 9), "4 of 9 points", id="ply too short"),
        pytest.param(ply(CLOUD)[:-3].rstrip(b"89. "), "number of columns changed", id="ply cut"),
        pytest.param(ply(CLOUD[:0], 2) + b"\n\n", "0 of 2 points", id="ply blank"),
        pytest.param(ply(CLOUD).replace(b"5.0", b"five"), "'five'", id="text for a number"),
        pytest.param(ply(CLOUD).replace(b"5.0", b"\xff"), "ascii", id="bytes for a number"),
        pytest.param(ply(CLOUD).replace(b"vertex 4", b"vertex -"), "damaged", id="no count"),
        pytest.param(ply(CLOUD).replace(b"float x", b"list x"), "'list'", id="no type"),
        pytest.param(ply(CLOUD).replace(b"vertex", b"face"), "element face 4", id="no vertices"),
        pytest.param(pcd(CLOUD)[:60], "no header of a cloud", id="pcd header cut"),
        pytest.param(pcd(CLOUD).replace(b" x y z", b" a b c"), "'x' is not in list", id="no x"),
        pytest.param(pcd(CLOUD).replace(b"SIZE 4", b"SIZE"), "damaged", id="sizes too few"),
        pytest.param(pcd(CLOUD).replace(b"TYPE F", b"TYPE S"), "'S 4'", id="no such type"),
        pytest.param(pcd(CLOUD).replace(b"SIZE 4", b"SIZE 3"), "damaged", id="no such size"),
        pytest.param(
            pcd(CLOUD).replace(b"binary", b"binary_compressed"), "only ascii", id="packed"
        ),
        pytest.param(pcd(CLOUD[2:3]), "holds no point", id="only NaN"),
        pytest.param(pcd(CLOUD[:0]), "holds no point", id="empty cloud"),
        pytest.param(pcd(CLOUD * 1e20), "a point is out of range", id="far away"),
        pytest.param(pcd(np.full((1, 3), np.inf)), "a point is out of range", id="infinite"),
        pytest.param(b"", "no header of a cloud", id="empty file"),
        pytest.param(b"hello\n", "no header of a cloud", id="foreign"),
        pytest.param(lzma.compress(pcd(CLOUD))[:-9], "damaged xz", id="xz cut"),
        pytest.param(b"\xfd7zXZ\x00rubbish", "damaged xz", id="xz rubbish"),
    ],
)
def test_damaged_clouds(tmp_path: Path, data: bytes, expected: str) -> None:
    (tmp_path / "scan1.pcd").write_bytes(data)
    message = failure(tmp_path)
    assert expected in message
    assert "scan1.pcd: " in message


def test_all_forms_of_a_cloud_hold_the_same_points(tmp_path: Path) -> None:
    """Every form that another program writes of one cloud, with fields that are passed over."""
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    points = np.random.default_rng(0).normal(size=(50, 3))
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(points[:, ::-1])
    cloud.colors = open3d.utility.Vector3dVector(np.abs(points) / 10)
    for kind in ("pcd", "ply"):
        for text in (True, False):
            file = tmp_path / f"cloud.{kind}"
            open3d.io.write_point_cloud(str(file), cloud, write_ascii=text)
            read = open_scans(file).points_of(0)
            theirs = np.asarray(open3d.io.read_point_cloud(str(file)).points)
            np.testing.assert_allclose(read, theirs, rtol=1e-12)
            np.testing.assert_allclose(read, points, atol=1e-5)


def test_a_cloud_in_the_other_order_of_bytes(tmp_path: Path) -> None:
    header, _ = ply(CLOUD[:2]).replace(b"ascii", b"binary_big_endian").split(b"end_header\n")
    path = tmp_path / "a.ply"
    path.write_bytes(header + b"end_header\n" + CLOUD[:2].astype(">f4").tobytes() + b"faces")
    assert points_of(open_scans(path)) == [CLOUD[:2].tolist()]


def test_a_result_of_a_run_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "map.ply").write_bytes(ply(CLOUD))
    put(tmp_path, "{}", "summary.json")
    assert "the folder holds no log of point scans" in failure(tmp_path)
    (tmp_path / "map.ply").unlink()
    assert "holds no cloud" in failure(tmp_path, "point-clouds")


# ---------------------------------------------------------------------------- all of them


@pytest.mark.parametrize(
    ("content", "format"),
    [(CORRECTED, "carmen-log"), (GRAPH, "carmen-log"), (LASER, "mrpt-laser2d")],
)
def test_recognised_by_content_whatever_the_name(tmp_path: Path, content: str, format: str) -> None:
    for name in ("a.log", "scans.npz", "x.csv.gz", "observations.csv"):
        path = put(tmp_path, content, name)
        assert points_of(open_scans(path)) == points_of(open_scans(path, format))
        with pytest.raises(RelmapError, match=rf"is a log of point scans \({format}\), expected"):
            open_log(path)


def test_other_things_are_refused(tmp_path: Path) -> None:
    assert "does not exist" in failure(tmp_path / "nothing")
    assert "format 'csv' is not known, expected scans-npz" in failure(tmp_path, "csv")
    message = failure(tmp_path)
    for dataset in SCAN_DATASETS:
        assert f"{dataset.name}: {dataset.description}" in message
    path = put(tmp_path, "iteration,x,y\n0,1,2\n", "observations.csv")
    for place in (path, tmp_path):
        assert "is a landmark log (observation-csv), expected a log of point" in failure(place)
    assert "line 1: 'hello' begins no log of point scans" in failure(put(tmp_path, "hello\n", "a"))
    assert "is empty" in failure(put(tmp_path, "", "b"))
    (tmp_path / "c").write_bytes(struct.pack("<4d", 1, 2, 3, 4))
    assert "NUL byte" in failure(tmp_path / "c")


def test_a_part_of_a_log(tmp_path: Path) -> None:
    log = open_scans(put(tmp_path, CORRECTED, "a.log"))
    part = log.between(1, 9)
    assert [(scan.iteration, scan.stamp_s) for scan in part.scans()] == [(1, 5.5)]
    assert points_of(part) == points_of(log)[1:]
    assert part.poses is not None
    assert part.poses.shape == (1, 4, 4)
    assert points_of(part.between(0, 2)) == points_of(part)
    with pytest.raises(RelmapError, match="scans 2:5 hold nothing: the log covers 0:2"):
        log.between(2, 5)


def test_relations(tmp_path: Path) -> None:
    path = put(tmp_path, f"# t1 t2\n1 2 3 4 5 0 0 {np.pi / 2}\n\n2 3 0 0 0 {np.pi} 0 0\n", "a")
    relations = read_relations(path)
    assert relations.begin_s.tolist() == [1, 2]
    assert relations.end_s.tolist() == [2, 3]
    expected = [[0, -1, 0, 3], [1, 0, 0, 4], [0, 0, 1, 5], [0, 0, 0, 1]]
    np.testing.assert_allclose(relations.T_begin_end[0], expected, atol=1e-12)
    np.testing.assert_allclose(np.diag(relations.T_begin_end[1]), [1, -1, -1, 1], atol=1e-12)
    for text, expected_text in (
        ("1 2 3\n", "line 1: '1 2 3', expected 8 numbers"),
        ("1 2 3 4 5 6 7 nan\n", "line 1"),
        ("1 2 3 4 5 6 7 x\n", "line 1"),
        ("# none\n", "holds no relation"),
    ):
        with pytest.raises(RelmapError, match=expected_text):
            read_relations(put(tmp_path, text, "b"))
