"""Files of unsupported formats are named in messages."""

from __future__ import annotations

import gzip
import io
import lzma
import os
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from relmap import PointMapper
from relmap.datasets import FORMATS, SCAN_FORMATS
from tests import logs, scanlogs
from tests.logs import put


def saved(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def zipped(name: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(name, "a")
    return stream.getvalue()


def saved_map() -> bytes:
    with TemporaryDirectory() as folder:
        PointMapper().save(Path(folder) / "mapper.npz")
        return (Path(folder) / "mapper.npz").read_bytes()


REST = bytes(range(256))
KITTI = np.array([[12.5, -3, 0.5, 0.25]] * 9, dtype="<f4").tobytes()
BAGS = [
    ("a.bag", b"#ROSBAG V2.0\nE\0\0\0" + REST, "a ROS 1 bag"),
    ("a.db3", b"SQLite format 3\0" + REST, "an SQLite database, as ROS 2 bags are"),
    ("a.mcap", b"\x89MCAP0\r\n" + REST, "an MCAP file, as ROS 2 bags are"),
]
FILES = [
    ("a.rawlog", gzip.compress(b"\x8dCSensoryFrame\x02\1\0" + REST), "an MRPT rawlog, packed by"),
    ("a.bin", KITTI, "a KITTI cloud"),
    ("a.las", b"LASF" + REST, "a LAS or LAZ file"),
    ("a.e57", b"ASTM-E57" + REST, "an E57 file"),
    ("a.npy", saved(np.eye(9)), "a NumPy array"),
    ("a.zip", zipped("readme.txt"), "a zip archive"),
    ("mapper.npz", saved_map(), "a saved map of relmap"),
    ("a.tar", b"a".ljust(257, b"\0") + b"ustar\0" + REST, "a tar archive"),
    ("a.gz", gzip.compress(saved(np.eye(9))), "a NumPy array (.npy), packed by gzip"),
    ("a.xz", lzma.compress(b"text"), "an xz file"),
]


@pytest.mark.parametrize(("name", "data", "found"), FILES)
def test_a_file_of_another_format_is_named(
    tmp_path: Path, name: str, data: bytes, found: str
) -> None:
    path = put(tmp_path, data, name)
    for failure, what, formats in (
        (logs.failure, "landmark log", FORMATS),
        (scanlogs.failure, "log of point scans", SCAN_FORMATS),
    ):
        message = failure(path)
        assert message.startswith(f"{path}: ")
        assert found in message
        assert what in message
        assert all(format in message for format in formats)
        for format in formats:
            if name != "a.bin" and format in ("carmen-log", "observation-csv", "scans-npz"):
                assert found.partition(", packed")[0] in failure(path, format)


@pytest.mark.parametrize(("name", "data", "found"), BAGS)
def test_an_unreadable_bag_is_named(tmp_path: Path, name: str, data: bytes, found: str) -> None:
    pytest.importorskip("rosbags")
    path = put(tmp_path, data, name)
    for failure in (logs.failure, scanlogs.failure):
        assert f"{path}: is {found}" in failure(path)
        assert ", but cannot be read: " in failure(path)
    named = put(tmp_path, data, "a")
    assert f"{named}: is {found}" in logs.failure(named)


def test_what_a_folder_holds_instead_is_named(tmp_path: Path) -> None:
    put(tmp_path, "a", "LICENSE")
    put(tmp_path, b"LASF" + REST, "000000.las")
    message = scanlogs.failure(tmp_path)
    assert "holds no log of point scans but '000000.las', a LAS or LAZ file, expected" in message
    put(tmp_path, "iteration,x,y\n".encode("utf-16"), "log.csv")
    assert "but 'log.csv', text in UTF-16, expected" in logs.failure(tmp_path)
    put(tmp_path, "rosbag2_bagfile_information:\n  version: 5\n", "metadata.yaml")
    assert "but a ROS 2 bag, expected" in scanlogs.failure(tmp_path)
    assert "but a ROS 2 bag, expected" in logs.failure(tmp_path)


@pytest.mark.parametrize(
    "data", [KITTI[:60], KITTI[:-1], b"\xff" * 64, np.full(16, 1e9, dtype="<f4").tobytes()]
)
def test_not_every_bin_is_a_cloud_of_kitti(tmp_path: Path, data: bytes) -> None:
    assert "KITTI" not in scanlogs.failure(put(tmp_path, data, "a.bin"))


def test_a_file_in_the_place_of_a_cloud_is_named(tmp_path: Path) -> None:
    for name, data, found in [*BAGS, FILES[0]]:
        put(tmp_path, data, "scan1.pcd")
        assert f"scan1.pcd: is {found}" in scanlogs.failure(tmp_path), name


@pytest.mark.parametrize("name", ["scans.npz", "drive.bag", "sensor_data.mat", "a.bin"])
def test_a_pipe_in_a_folder_is_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    assert "holds no log of point scans, expected" in scanlogs.failure(tmp_path)
    assert "holds no landmark log, expected" in logs.failure(tmp_path)
