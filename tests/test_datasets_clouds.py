"""Folders of point clouds: PCD and PLY files, plain and packed."""

from __future__ import annotations

import lzma
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.datasets import open_scans
from tests.logs import put
from tests.scanlogs import CLOUD, failure, lzf, packed_pcd, pcd, ply, points_of


def lzf_pcd(packed: bytes, size: int) -> bytes:
    """Return a cloud of four points with such packed data."""
    header = packed_pcd(CLOUD).partition(b"compressed\n")
    return b"".join(header[:2]) + np.array([len(packed), size], "<u4").tobytes() + packed


@pytest.mark.parametrize("write", [pcd, ply, packed_pcd])
@pytest.mark.parametrize("packed", [False, True])
def test_clouds_in_the_order_of_their_numbers(
    tmp_path: Path, write: Callable[[Floats], bytes], packed: bool
) -> None:
    for number in (2, 10, 9):
        data = write(CLOUD * number)
        name = f"scan{number}.{write.__name__[-3:]}" + ".xz" * packed
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


def test_clouds_of_a_2d_laser_are_its_scans(tmp_path: Path) -> None:
    bearings = np.linspace(-1.5, 1.5, 40)
    fan = np.column_stack([np.cos(bearings), np.sin(bearings), np.zeros(40)])
    fan *= (2 + np.cos(7 * bearings))[:, None]
    fan[5] = 0.0  # a beam without a return
    for k in range(8):
        (tmp_path / f"{k}.pcd").write_bytes(pcd((1 + k / 10) * fan[:: 1 - 2 * (k % 2)]))
    laser = open_scans(tmp_path)
    assert laser.dimension == 2
    expected = [(1 + k / 10) * np.delete(fan, 5, axis=0)[:: 1 - 2 * (k % 2), :2] for k in range(8)]
    assert np.allclose(points_of(laser), expected)
    (tmp_path / "7.pcd").write_bytes(pcd(fan + np.array([0.1, 0.0, 0.3])))  # on the robot
    assert points_of(open_scans(tmp_path))[:7] == points_of(laser)[:7]
    for other in (fan[:, [0, 1, 1]], np.random.default_rng(1).permutation(fan)):
        (tmp_path / "7.pcd").write_bytes(pcd(other))
        assert open_scans(tmp_path).dimension == 3


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
    assert log.poses[:, :3, 3].tolist() == [[1, 5, 6], [2, 5, 6]]
    assert log.poses[:, 3].tolist() == [[0, 0, 0, 1]] * 2
    put(tmp_path, "\n".join(rows).replace("102.0,", "99.0,"), "alidarPose.csv")
    (tmp_path / "full2.pcd").write_bytes(pcd(2 * CLOUD))
    earlier = open_scans(tmp_path)
    assert earlier.stamps_s.tolist() == [99, 101]
    assert earlier.poses[:, 0, 3].tolist() == [2, 1]
    assert points_of(earlier)[0] == (2 * CLOUD[[0, 1, 3]]).tolist()
    put(tmp_path, "\n".join(rows[:9]), "alidarPose.csv")
    assert "alidarPose.csv: no rows for full2.pcd" in failure(tmp_path)
    put(tmp_path, "\n".join(rows[:1] + rows[2:] + rows[:1]), "alidarPose.csv")
    assert "alidarPose.csv: not 4 rows a pose" in failure(tmp_path)
    put(tmp_path, "\n".join([*rows[:8], rows[9], rows[8], *rows[10:]]), "alidarPose.csv")
    assert "alidarPose.csv: pose 1 has no rotation" in failure(tmp_path)
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
        pytest.param(pcd(CLOUD).replace(b" x y z", b" x b c"), "'no field y, z'", id="no x"),
        pytest.param(pcd(CLOUD).replace(b"SIZE 4", b"SIZE"), "damaged", id="sizes too few"),
        pytest.param(pcd(CLOUD).replace(b"TYPE F", b"TYPE S"), "'S 4'", id="no such type"),
        pytest.param(pcd(CLOUD).replace(b"SIZE 4", b"SIZE 3"), "damaged", id="no such size"),
        pytest.param(pcd(CLOUD).replace(b"binary", b"packed"), "only ascii", id="no such form"),
        pytest.param(packed_pcd(CLOUD)[:-5], "4 of 4 points, packed to", id="lzf cut"),
        pytest.param(packed_pcd(CLOUD).partition(b"sed\n")[0] + b"sed\n12", "0 of 4", id="no lzf"),
        pytest.param(packed_pcd(CLOUD).replace(b"S 4", b"S 5"), "4 of 5 points", id="lzf short"),
        pytest.param(lzf_pcd(b"\x1f" + bytes(32), 48), "do not unpack to 48", id="too little"),
        pytest.param(lzf_pcd(b"\x1f" + bytes(32) + b"\x1f" + bytes(32), 48), "do not", id="much"),
        pytest.param(lzf_pcd(b"\x00a\xe0", 48), "do not unpack", id="repetition cut"),
        pytest.param(lzf_pcd(b"\x00a\x20\x01\x1f", 48), "do not", id="before the beginning"),
        pytest.param(lzf_pcd(b"\x00a\xe0\x24\x00\x1f", 48), "do not", id="literal cut"),
        pytest.param(lzf_pcd(b"\x00", 48), "do not unpack", id="nothing"),
        pytest.param(lzf_pcd(b"", 48), "0 packed bytes for 48", id="bomb"),
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


@pytest.mark.parametrize("none", [CLOUD[:0], CLOUD[2:3]], ids=["no point", "only NaN"])
@pytest.mark.parametrize("write", [pcd, ply, packed_pcd])
def test_a_cloud_without_points_among_others_is_an_empty_scan(
    tmp_path: Path, write: Callable[[Floats], bytes], none: Floats
) -> None:
    for number, points in enumerate([CLOUD, none, CLOUD]):
        (tmp_path / f"{number}.{write.__name__[-3:]}").write_bytes(write(points))
    assert [len(points) for points in points_of(open_scans(tmp_path))] == [3, 0, 3]


def test_all_forms_of_a_cloud_hold_the_same_points(tmp_path: Path) -> None:
    """Every form that another program writes of one cloud, with fields that are skipped."""
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    points = np.random.default_rng(0).normal(size=(50, 3))
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(points[:, ::-1])
    cloud.colors = open3d.utility.Vector3dVector(np.abs(points) / 10)
    for kind in ("pcd", "ply"):
        for text, packed in ((True, False), (False, False), (False, True)):
            file = tmp_path / f"cloud.{kind}"
            open3d.io.write_point_cloud(str(file), cloud, write_ascii=text, compressed=packed)
            read = open_scans(file).points_of(0)
            theirs = np.asarray(open3d.io.read_point_cloud(str(file)).points)
            np.testing.assert_allclose(read, theirs, rtol=1e-12)
            np.testing.assert_allclose(read, points, atol=1e-5)


def test_packed_fields_stand_one_after_another(tmp_path: Path) -> None:
    """Fields of other sizes, or of several numbers, are skipped."""
    n = 500
    rng = np.random.default_rng(0)
    points = rng.normal(size=(n, 3)).round(1)
    header = (
        "VERSION 0.7\nFIELDS x ring y shape z\nSIZE 8 2 8 4 8\nTYPE F U F F F\nCOUNT 1 1 1 3 1\n"
        f"WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA binary_compressed\n"
    )
    between = [np.arange(n, dtype="<u2"), np.zeros((n, 3), dtype="<f4")]
    fields = [points[:, 0], between[0], points[:, 1], between[1], points[:, 2]]
    content = b"".join(field.tobytes() for field in fields)
    packed = lzf(content)
    sizes = np.array([len(packed), len(content)], dtype="<u4").tobytes()
    (tmp_path / "a.pcd").write_bytes(header.encode() + sizes + packed)
    assert points_of(open_scans(tmp_path)) == [points.tolist()]


def test_a_cloud_in_the_other_order_of_bytes(tmp_path: Path) -> None:
    header, _ = ply(CLOUD[:2]).replace(b"ascii", b"binary_big_endian").split(b"end_header\n")
    path = tmp_path / "a.ply"
    path.write_bytes(header + b"end_header\n" + CLOUD[:2].astype(">f4").tobytes() + b"faces")
    assert points_of(open_scans(path)) == [CLOUD[:2].tolist()]


def test_a_result_of_a_run_is_not_a_log(tmp_path: Path) -> None:
    (tmp_path / "map.ply").write_bytes(ply(CLOUD))
    put(tmp_path, "{}", "summary.json")
    assert "the folder holds no log of point scans" in failure(tmp_path)
    (tmp_path / "map.ply").unlink()
    assert "holds no cloud" in failure(tmp_path, "point-clouds")


def test_clouds_are_a_log_also_beside_the_result_of_their_run(tmp_path: Path) -> None:
    for name in ("1.ply", "2.ply", "map.ply"):
        (tmp_path / name).write_bytes(ply(CLOUD))
    assert len(open_scans(tmp_path)) == 3
    put(tmp_path, "{}", "summary.json")
    assert len(open_scans(tmp_path)) == 2
