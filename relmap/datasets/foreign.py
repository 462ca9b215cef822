"""Detection of other formats by their first bytes, for messages."""

from __future__ import annotations

import math
import os
import struct
import zlib
from pathlib import Path

HEAD_BYTES = 512
"""Number of first bytes used to identify a format."""
BAGS = (
    "a ROS 1 bag",
    "an SQLite database, as ROS 2 bags are (.db3)",
    "an MCAP file, as ROS 2 bags are",
)
ZIP, PARQUET, MATLAB = "a zip archive", "a Parquet file", "a MATLAB file"
UTF16 = "text in UTF-16"
_MOST_FILES = 20
"""Maximum number of files of a folder that are examined."""
_GZIP_MAGIC, _GZIP_WINDOW = b"\x1f\x8b", 31
_MAGIC = (
    (0, b"#ROSBAG V2", BAGS[0]),
    (0, b"SQLite format 3\0", BAGS[1]),
    (0, b"\x89MCAP0\r\n", BAGS[2]),
    (0, b"LASF", "a LAS or LAZ file"),
    (0, b"ASTM-E57", "an E57 file"),
    (0, b"\x93NUMPY", "a NumPy array (.npy)"),
    (30, b"checksum.npy", "a saved map of relmap"),
    (0, b"PK\x03\x04", ZIP),
    (0, b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    (0, b"MATLAB 5.0 MAT-file", MATLAB),
    (0, b"PAR1", PARQUET),
    (0, b"\xff\xfe", UTF16),
    (0, b"\xfe\xff", UTF16),
    (0, b"BZh", "a bzip2 file"),
    (0, b"\xfd7zXZ\0", "an xz file"),
    (0, b"\x28\xb5\x2f\xfd", "a Zstandard file"),
    (0, b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive"),
    (257, b"ustar", "a tar archive"),
    (1, b"CSensoryFrame", "an MRPT rawlog"),
    (1, b"CActionCollection", "an MRPT rawlog"),
    (1, b"CObservation", "an MRPT rawlog"),
    (1, b"CRawlog", "an MRPT rawlog"),
)
"""Offset and bytes that identify a format, and its name."""
OTHER_BIN = "a .bin file, not of float32 x, y, z, reflectance (0 to 1)"
_ROS2_FOLDER = "metadata.yaml", b"rosbag2_bagfile_information"
_KITTI = struct.Struct("<16f")
"""Four points: x, y, z and the reflectance."""
_KITTI_FAR_M = 500.0


def foreign_format(head: bytes) -> str | None:
    """Return the name of another format from the first bytes; None if unknown."""
    if head.startswith(_GZIP_MAGIC):
        try:
            inner = zlib.decompressobj(_GZIP_WINDOW).decompress(head, HEAD_BYTES)
        except zlib.error:
            return None
        found = foreign_format(inner)
        return f"{found}, packed by gzip" if found else None
    return next((name for at, magic, name in _MAGIC if head.startswith(magic, at)), None)


def foreign_at(path: Path) -> str | None:
    """Return the other format of a file, or of a folder's content; None if unknown."""
    if not os.path.isdir(path):
        found = _foreign_file(path)
        return None if found and UTF16 in found else found  # readers of text name the line
    name, hallmark = _ROS2_FOLDER
    if hallmark in _head(path / name):
        return "a ROS 2 bag"
    try:
        files = sorted(file for file in path.iterdir() if file.is_file())[:_MOST_FILES]
    except OSError:
        return None
    foreign = [(file, kind) for file in files if (kind := _foreign_file(file))]
    foreign.sort(key=lambda pair: UTF16 not in pair[1])  # the others may belong to it
    return f"{foreign[0][0].name!a}, {foreign[0][1]}" if foreign else None


def _foreign_file(file: Path) -> str | None:
    head = _head(file)
    found = foreign_format(head)
    if found or not head or file.suffix.lower() != ".bin":
        return found
    return "a KITTI cloud (.bin)" if is_kitti(file) else OTHER_BIN


def is_kitti(file: Path) -> bool:
    """Return whether a file may contain points in KITTI's format, which has no magic number."""
    head = _head(file)
    if len(head) < _KITTI.size or file.stat().st_size % 16:
        return False
    numbers = _KITTI.unpack_from(head)
    near = all(math.isfinite(n) and abs(n) < _KITTI_FAR_M for n in numbers)
    return near and all(0 <= n <= 1 for n in numbers[3::4])


def _head(file: Path) -> bytes:
    """Return the first bytes of a file; none if it cannot be read, or is a pipe."""
    try:
        if file.is_file():
            with file.open("rb") as stream:
                return stream.read(HEAD_BYTES)
    except (OSError, ValueError):
        pass
    return b""
