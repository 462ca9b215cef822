"""KITTI's clouds and depth images: read, and refused where they are damaged."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from PIL import Image

from relmap.core.arrays import Floats
from relmap.datasets import open_scans
from relmap.datasets.trajectories import read_trajectory
from relmap.evaluation.truth import read_truth
from tests.logs import put
from tests.scanlogs import failure, points_of

CLOUD = np.array([[1.0, 2, 3], [4, 5, 6], [0, 1, 0], [7, 8, 9], [np.nan, 0, 0]])
SEEN = [0, 1, 2, 3]

DEPTH = np.zeros((8, 12), dtype=np.uint16)
DEPTH[2, 4], DEPTH[4, 10], DEPTH[6, 0] = 2000, 1000, 65535
K = "10 0 4\n0 20 2\n0 0 1\n"


def kitti(points: Floats) -> bytes:
    return np.column_stack([points, np.full(len(points), 0.5)]).astype("<f4").tobytes()


def png(image: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "PNG")
    return stream.getvalue()


_SIZE = b"IHDR" + struct.pack(">IIBBBBB", 20_000, 20_000, 16, 0, 0, 0, 0)
HUGE = b"\x89PNG\r\n\x1a\n\0\0\0\r" + _SIZE + struct.pack(">I", zlib.crc32(_SIZE))
HUGE += b"\0\0\0\0IDAT" + struct.pack(">I", zlib.crc32(b"IDAT"))
"""The beginning of an image that would need 800 MB."""


def images(folder: Path) -> Path:
    for number in (1, 10, 9):
        put(folder, png(DEPTH * np.uint16(number == 1)), f"frame-{number:06d}.depth.png")
    put(folder, png(DEPTH), "frame-000009.depth.png")
    return put(folder, K, "camera-intrinsics.txt").parent


@pytest.mark.parametrize("inner", ["", "velodyne", "lidar"])
def test_clouds_of_kitti_in_the_order_of_their_numbers(tmp_path: Path, inner: str) -> None:
    (tmp_path / inner).mkdir(exist_ok=True)
    for number in (2, 10, 9):
        put(tmp_path / inner, kitti(CLOUD * number), f"{number}.bin")
    log = open_scans(tmp_path)
    assert log.dimension == 3
    assert log.poses is None
    assert points_of(log) == [(CLOUD[SEEN] * k).tolist() for k in (2, 9, 10)]


def test_poses_of_kitti(tmp_path: Path) -> None:
    for number in range(2):
        put(tmp_path, kitti(CLOUD), f"{number}.bin")
    put(tmp_path, "1 0 0 5 0 1 0 6 0 0 1 7\n0 -1 0 1 1 0 0 2 0 0 1 3\n", "poses.txt")
    poses = open_scans(tmp_path).poses
    assert poses[:, :3, 3].tolist() == [[5, 6, 7], [1, 2, 3]]
    assert poses[1, :2, :2].tolist() == [[0, -1], [1, 0]]
    put(tmp_path, "1 0 0 5 0 1 0 6 0 0 1 7\n0 1 0 1 1 0 0 2 0 0 1 3\n", "poses.txt")
    assert "pose 1 has no rotation" in failure(tmp_path)
    put(tmp_path, "1 0 0 5 0 1 0 6 0 0 1 7\n", "poses.txt")
    assert "1 poses, expected one for each of 2 clouds" in failure(tmp_path)


@pytest.mark.parametrize("inner", ["", "velodyne"])
def test_times_of_kitti(tmp_path: Path, inner: str, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / inner).mkdir(exist_ok=True)
    for number in range(3):
        put(tmp_path / inner, kitti(CLOUD * (number + 1)), f"{number}.bin")
    put(tmp_path, "0.0e+00\n1.5e+00\n2.0e+00\n9.0e+00\n", "times.txt")
    pose = "1 0 0 {} 0 1 0 0 0 0 1 0\n"
    put(tmp_path, "".join(map(pose.format, range(4))), "poses.txt")
    assert open_scans(tmp_path).stamps_s.tolist() == [0.0, 1.5, 2.0]
    assert read_trajectory(tmp_path / "poses.txt")[0].tolist() == [0.0, 1.5, 2.0, 9.0]
    put(tmp_path, "0\n2.5\n2.0\n", "times.txt")
    log = open_scans(tmp_path)
    assert "out of order" in caplog.text
    assert log.stamps_s.tolist() == [0.0, 2.0, 2.5]
    assert points_of(log) == [(CLOUD[SEEN] * k).tolist() for k in (1, 3, 2)]
    assert log.poses[:, 0, 3].tolist() == [0, 2, 1]
    assert log.numbers.tolist() == [0, 2, 1]
    put(tmp_path, "0\n1\n", "times.txt")
    assert "times.txt: 2 times, expected one for each of 3 clouds" in failure(tmp_path)


def test_a_file_of_position_and_quaternion_for_each_cloud(tmp_path: Path) -> None:
    for folder in ("lidar", "poses"):
        (tmp_path / folder).mkdir()
    put(tmp_path / "lidar", kitti(CLOUD), "000001.bin")
    put(tmp_path / "poses", "1.0, 2.0, 3.0\n0.0, 0.0, 1.0, 0.0", "000001.txt")
    poses = open_scans(tmp_path).poses
    assert np.abs(poses[0, :3] - [[-1, 0, 0, 1], [0, -1, 0, 2], [0, 0, 1, 3]]).max() < 1e-12
    put(tmp_path / "poses", b"\xef\xbb\xbf1.0, 2.0, 3.0\r\n", "000001.txt")
    poses = open_scans(tmp_path).poses
    assert poses[0, :3, 3].tolist() == [1, 2, 3]
    put(tmp_path / "poses", "1.0, 2.0".encode("utf-16"), "000001.txt")
    assert "a NUL byte: text in UTF-16, expected UTF-8 text" in failure(tmp_path)
    put(tmp_path / "poses", "1.0, 2.0", "000001.txt")
    assert "2 numbers, expected x, y, z, qx, qy, qz, qw" in failure(tmp_path)


def test_depth_images_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in (2, 10, 9):
        put(tmp_path, png(DEPTH[: number + 1]), f"frame-{number}.depth.png")
    put(tmp_path, K, "camera-intrinsics.txt")
    assert [len(points) for points in points_of(open_scans(tmp_path))] == [1, 2, 2]


def test_depth_images_come_out_ahead_left_and_up(tmp_path: Path) -> None:
    log = open_scans(images(tmp_path))
    # Pixel (2, 4) looks straight ahead at 2 m; (4, 10) at 1 m, 0.6 m to the right, 0.1 m down.
    expected = [[2.0, 0.0, 0.0], [1.0, -0.6, -0.1]]
    assert points_of(log) == [expected, expected, []]
    assert log.poses is None
    for number in (1, 9, 10):
        put(tmp_path, "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n", f"frame-{number:06d}.pose.txt")
    poses = open_scans(tmp_path).poses
    for wrong, rows in {
        "pose 0 has no rotation": "0 1 0 6\n1 0 0 5\n0 0 1 7\n0 0 0 1\n",
        "the last row is not 0 0 0 1": "1 0 0 5\n0 1 0 6\n0 0 0 1\n0 0 1 7\n",
    }.items():
        put(tmp_path, rows, "frame-000009.pose.txt")
        assert f"frame-000009.pose.txt: {wrong}" in failure(tmp_path)
    ahead = poses[0] @ [2.0, 0.0, 0.0, 1.0]
    assert ahead.tolist() == [5, 6, 9, 1]  # the camera's z


@pytest.mark.parametrize(
    ("name", "data", "wrong"),
    [
        ("camera-intrinsics.txt", "1 2\n", "line 1: '1 2', expected 3 numbers"),
        ("camera-intrinsics.txt", "1 2 x\n", "line 1: '1 2 x', expected 3 numbers"),
        ("camera-intrinsics.txt", "1 2 3\n", "1 rows, expected a 3 x 3 matrix"),
        ("camera-intrinsics.txt", K.replace("10", "-10"), "focal lengths above 0"),
        ("camera-intrinsics.txt", "0 0 1\n10 0 4\n0 20 2\n", "focal lengths above 0"),
        ("camera-intrinsics.txt", "10 0 4\n5 20 2\n0 0 1\n", "expected rows fx s cx"),
        ("frame-000001.depth.png", b"no image", "frame-000001.depth.png"),
        ("frame-000001.depth.png", png(DEPTH)[:60], "frame-000001.depth.png"),
        ("frame-000001.depth.png", png(DEPTH.astype(np.uint8)), "one channel of 16 bits"),
        ("frame-000001.depth.png", png(DEPTH > 0), "one channel of 16 bits"),
        ("frame-000001.depth.png", HUGE, "400000000 pixels"),
    ],
)
def test_damaged_depth_images_are_refused(
    tmp_path: Path, name: str, data: bytes | str, wrong: str
) -> None:
    put(images(tmp_path), data, name)
    assert wrong in failure(tmp_path)


def tum(folder: Path, times: str = "3.5 2.5", lists: str = "depth.txt") -> Path:
    (folder / "depth").mkdir(parents=True)
    for time in times.split():
        put(folder / "depth", png(DEPTH * np.uint16(5)), f"{time}.png")
    rows = "".join(f"{time} depth/{time}.png\n" for time in times.split())
    put(folder, K, "camera-intrinsics.txt")
    return put(folder, f"# depth maps\n{rows}", lists).parent


def test_depth_images_of_tum_in_the_order_of_their_times(tmp_path: Path) -> None:
    put(tum(tmp_path / "a"), "2 0 0 7 0 0 0 1\n3 0 0 9 0 0 0 1\n", "groundtruth.txt")
    log = open_scans(tmp_path / "a")
    # As of 7-Scenes above; 65535, times five and cut to 16 bits, is a point here.
    points = points_of(log)
    assert [scan[:2] for scan in points] == [[[2.0, 0.0, 0.0], [1.0, -0.6, -0.1]]] * 2
    assert log.stamps_s.tolist() == [2.5, 3.5]
    assert (log.poses[0] @ [2.0, 0.0, 0.0, 1.0]).tolist() == [0, 0, 10, 1]  # the camera's z
    assert np.isnan(log.poses[1]).all()
    assert read_truth(tmp_path / "a", "planes3d").stamps_s.tolist() == [2.5]


def test_poses_of_tum_where_times_repeat(tmp_path: Path) -> None:
    folder = tum(tmp_path / "a", "2 4")
    put(folder, "4 depth/4.png\n2 depth/2.png\n2 depth/2.png\n", "depth.txt")
    put(folder, "2 0 0 7 0 0 0 1\n4 0 0 9 0 0 0 1\n", "groundtruth.txt")
    log = open_scans(folder)
    assert log.stamps_s.tolist() == [0, 1, 2]
    assert log.poses[:, 2, 3].tolist() == [7, 7, 9]


def test_associations_of_tum_in_either_order(tmp_path: Path) -> None:
    folder = tum(tmp_path / "a", "1 2", "associations.txt")
    put(folder, "1 rgb/1.png 1.25 depth/1.png\n2 depth/2.png 2.1 rgb/2.png\n", "associations.txt")
    assert open_scans(folder).stamps_s.tolist() == [1.25, 2]


def test_intrinsics_of_tum_by_the_name_or_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ahead = {}
    for name in ("rgbd_dataset_freiburg3_desk", "desk"):
        (tum(tmp_path / name) / "camera-intrinsics.txt").unlink()
        ahead[name] = points_of(open_scans(tmp_path / name))[0][0]
        assert ("intrinsics of the camera are unknown" in caplog.text) == (name == "desk")
    right, down = np.array([320.1 - 4, 247.6 - 2]) / [535.4, 539.2] * 2
    assert_allclose(ahead["rgbd_dataset_freiburg3_desk"], [2, right, down])
    assert_allclose(ahead["desk"], [2, 315.5 / 525 * 2, 237.5 / 525 * 2])


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("1 rgb/1.png", "line 1: '1 rgb/1.png', expected a time and a name depth/*.png"),
        ("x depth/1.png", "expected a time and a name depth/*.png"),
        ("depth/1.png 1", "expected a time and a name depth/*.png"),
        ("1 depth/../../1.png", "expected a time and a name depth/*.png"),
        ("1 depth/0.png", "0.png: does not exist"),
        ("# 1 depth/1.png", "lists no image"),
    ],
)
def test_wrong_lists_of_tum_are_refused(tmp_path: Path, line: str, wrong: str) -> None:
    put(tum(tmp_path / "a", "1"), line, "depth.txt")
    assert wrong in failure(tmp_path / "a")


@pytest.mark.parametrize(
    ("data", "wrong"),
    [
        (kitti(CLOUD)[:-3], "77 bytes, expected four float32 for each point"),
        (kitti(CLOUD + np.inf), "out of range"),
    ],
)
def test_damaged_clouds_of_kitti_are_refused(tmp_path: Path, data: bytes, wrong: str) -> None:
    put(tmp_path, kitti(CLOUD * 1.5), "0.bin")
    put(tmp_path, data, "1.bin")
    assert wrong in failure(tmp_path, "kitti-bin")


def test_an_empty_cloud_of_kitti_is_an_empty_scan(tmp_path: Path) -> None:
    for number, data in enumerate([kitti(CLOUD * 1.5), b"", kitti(CLOUD[[4]])]):
        put(tmp_path, data, f"{number}.bin")
    assert [len(points) for points in points_of(open_scans(tmp_path))] == [4, 0, 0]


@pytest.mark.parametrize("width", [3, 5])
def test_another_number_of_floats_a_point_is_named(tmp_path: Path, width: int) -> None:
    points = np.random.default_rng(0).normal(size=(400, width)).astype("<f4")
    put(tmp_path, points.tobytes(), "0.bin")
    expected = "but '0.bin', a .bin file, not of float32 x, y, z, reflectance (0 to 1), expected"
    assert expected in failure(tmp_path)
    assert "a reflectance is below 0, expected four float32" in failure(tmp_path, "kitti-bin")


def test_a_folder_without_clouds_is_refused(tmp_path: Path) -> None:
    assert "holds no .bin file" in failure(tmp_path, "kitti-bin")
    assert "holds no *.depth.png" in failure(tmp_path, "depth-images")
    assert "holds no depth.txt or associations.txt" in failure(tmp_path, "tum-rgbd")


def test_a_decoder_that_runs_out_of_memory_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images(tmp_path)

    def damaged(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(Image, "open", damaged)
    assert "frame-000001.depth.png: cannot be read" in failure(tmp_path, "depth-images")
