"""A folder of point clouds, one file per scan: PCD or PLY, text or binary, plain or packed by xz.

Of a file, also of PCD packed by LZF, only the points' x, y and z are read. They are not read by
open3d because it invents missing data of damaged files: for a truncated PLY text it returns as many
points as the header states, the last ones arbitrary, and in a PCD text it reads a word as 0
(version 0.20). The formats: PCD 0.7,
https://pointclouds.org/documentation/tutorials/pcd_file_format.html; PLY 1.0, G. Turk, Stanford
1994.

The scans are sorted by the numbers in their names. ``alidarPose.csv`` beside them (as in BALM, Z.
Liu and F. Zhang, RA-L 2021) gives the reference poses: rows 4N to 4N + 3 are the matrix
T_reference_robot of file number N, with the time, which then defines the order, in its last cell.
"""

from __future__ import annotations

import lzma
import os
import re
import struct
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets.assembly import MAX_COORDINATE_M
from relmap.datasets.foreign import HEAD_BYTES, foreign_format
from relmap.datasets.headers import numbered_files, numbers_in_name
from relmap.datasets.number_rows import read_rows
from relmap.datasets.scans import ScanLog, require_rotations, sorted_by_time
from relmap.datasets.textfile import invalid, quoted, shown, unreadable

POSES_FILE = "alidarPose.csv"
_ROW = "4 numbers: a row of a 4 x 4 matrix"

_NAME = re.compile(r"\.(pcd|ply)(\.xz)?$", re.IGNORECASE)
_RESULT, _MAP = "summary.json", "map.ply"
"""A folder with the first holds a result, and the second is its map."""

MAX_BYTES, MAX_POINTS = 1 << 28, 1 << 23
"""Limits of an unpacked cloud, 256 MiB and eight million points: all of it is held in memory."""

_XZ_MAGIC = b"\xfd7zXZ\x00"
_XZ_BLOCK, _XZ_MEMORY = 1 << 22, 1 << 28
_HEADER_BYTES = 1 << 16
_MOST_NUMBERS = 10_000
"""Maximum number of values per field of a point."""
_END = re.compile(rb"^(?:DATA[^\n]*|end_header[ \t\r]*)\n", re.MULTILINE)
_MAGIC = re.compile(rb"ply\r?\n|# \.PCD|VERSION|FIELDS")
_PCD_TYPES = {
    f"{kind} {size}": f"<{kind.lower()}{size}"
    for kind, sizes in (("F", "48"), ("I", "1248"), ("U", "1248"))
    for size in sizes
}
_PCD_FORMS = ("ascii", "binary", "binary_compressed")
_LZF_SIZES = struct.Struct("<II")
"""Numbers of packed and unpacked bytes, stored before the packed ones."""
_PLY_TYPES = dict(
    {"char": "i1", "short": "i2", "int": "i4", "float": "f4", "double": "f8"},
    **{"uchar": "u1", "ushort": "u2", "uint": "u4", "float32": "f4", "float64": "f8"},
    **{f"int{8 * size}": f"i{size}" for size in (1, 2, 4)},
    **{f"uint{8 * size}": f"u{size}" for size in (1, 2, 4)},
)
_PLY_ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class PointClouds:
    """Reads a folder of PCD or PLY files, or one such file."""

    name = "point-clouds"
    description = "a folder of .pcd or .ply files (or .xz)"

    def recognises(self, path: Path) -> bool:
        """Return whether it is such a file, or a folder of them, not just of a map of relmap."""
        if not os.path.isdir(path):
            return _is_cloud(path)
        return bool(_clouds(path))

    def load(self, path: Path) -> ScanLog:
        """Read the log; clouds are read lazily, without NaN, which are beams without a return."""
        files = _clouds(path) if os.path.isdir(path) else [path]
        if not files:
            raise invalid(path, f"holds no cloud, expected {self.description}")
        numbers, poses_file = np.arange(len(files), dtype=float), files[0].with_name(POSES_FILE)
        log = ScanLog(3, numbers, lambda index: read_cloud(files[index]))
        if not poses_file.is_file():
            return log
        stamps_s, poses = _read_poses(poses_file, files)
        return sorted_by_time(poses_file, replace(log, poses=poses), stamps_s)


def _clouds(folder: Path) -> list[Path]:
    """Return the clouds in a folder, without the map of a result written there."""
    is_result = (folder / _RESULT).exists()
    return [file for file in numbered_files(folder, _NAME) if not (is_result and file.name == _MAP)]


def _read_poses(file: Path, clouds: list[Path]) -> tuple[Floats, Floats]:
    """Return the stamps (k,) and poses (k, 4, 4) of the clouds."""
    rows = read_rows(file, [sys.float_info.max] * 4, "row", _ROW, separator=",").values
    numbers = [numbers_in_name(cloud, _NAME) for cloud in clouds]
    for cloud, name in zip(clouds, numbers, strict=True):
        if len(name) != 1 or 4 * name[0] + 4 > len(rows):
            problem = f"no rows for {shown(cloud.name)}, expected 4 for each number from 0"
            raise invalid(file, problem)
    first = 4 * np.array(numbers)
    matrices = rows[first + np.arange(4)]
    stamps_s = matrices[:, 3, 3].copy()
    if matrices[:, 3, :3].any() or len(rows) % 4:
        raise invalid(file, "not 4 rows a pose, expected the last to be 0, 0, 0, t")
    matrices[:, 3] = [0.0, 0.0, 0.0, 1.0]
    require_rotations(file, matrices)
    return stamps_s, matrices


@dataclass(frozen=True)
class _Layout:
    """Storage layout of the points of a file.

    Each number of a point has a name and a numpy type. Points packed by LZF are stored field by
    field, and `fields` gives the number of values of each field; otherwise it is empty.
    """

    count: int
    names: Sequence[str]
    types: Sequence[str]
    text: bool
    fields: Sequence[int] = ()


def _is_cloud(file: Path) -> bool:
    """Return whether a file, unpacked, begins with the header of a PCD or PLY file."""
    try:
        return _header_end(_unpacked(file, _HEADER_BYTES)) is not None
    except RelmapError:
        return False


def read_cloud(file: Path) -> Floats:
    """Read the points of a PCD or PLY file, plain or packed by xz.

    Returns (n, 3), metres: without NaN points, which are beams without a return; n may be 0. Raises
    `RelmapError` if the file is damaged, or has less data than it states.
    """
    data = _unpacked(file, MAX_BYTES)
    end = _header_end(data)
    if end is None:
        found = foreign_format(data[:HEAD_BYTES])
        what = f"is {found}, not a point cloud" if found else "no header of a cloud"
        raise invalid(file, f"{what}, expected a PCD or PLY file")
    try:
        header = [line.split() for line in data[:end].decode("ascii").splitlines()]
        layout = (_ply if header[0] == ["ply"] else _pcd)([line for line in header if line])
        points = _points(layout, data, end)
    except (ValueError, KeyError, IndexError) as error:
        problem = f"damaged: {quoted(str(error))}"
        raise invalid(file, f"{problem}; expected a whole PCD or PLY file") from error
    points = points[~np.isnan(points).any(axis=1)]
    if not (np.abs(points) <= MAX_COORDINATE_M).all():
        raise invalid(file, "a point is out of range, expected coordinates in metres")
    return points


def _unpacked(file: Path, most: int) -> bytes:
    """Return at most the maximum number of bytes of a file, plus one."""
    try:
        with file.open("rb") as stream:
            packed = stream.read(len(_XZ_MAGIC)) == _XZ_MAGIC
            stream.seek(0)
            data = _without_xz(stream, most + 1) if packed else stream.read(most + 1)
    except (lzma.LZMAError, EOFError) as error:
        reason = quoted(str(error))
        raise invalid(file, f"damaged xz: {reason}; expected a whole file") from error
    except (OSError, ValueError) as error:
        raise unreadable(file, error) from error
    if len(data) > MAX_BYTES:
        raise invalid(file, f"more than {MAX_BYTES} bytes, expected at most that")
    return data


def _without_xz(stream: BinaryIO, most: int) -> bytes:
    """Return the first unpacked bytes of an xz file, up to a limit."""
    unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ, _XZ_MEMORY)
    data = b""
    while not unpacker.eof and len(data) < most:
        block = stream.read(_XZ_BLOCK) if unpacker.needs_input else b""
        if not block and unpacker.needs_input:
            raise EOFError("cut short")
        data += unpacker.decompress(block, most - len(data))
    return data


def _header_end(data: bytes) -> int | None:
    """Return the end of the header; None if there is none."""
    end = _END.search(data, 0, _HEADER_BYTES) if _MAGIC.match(data) else None
    return end and end.end()


def _pcd(header: list[list[str]]) -> _Layout:
    """Read a PCD header; ValueError, KeyError or IndexError if invalid."""
    entries = {line[0]: line[1:] for line in header if not line[0].startswith("#")}
    counts = [int(text) for text in entries.get("COUNT", ["1"] * len(entries["FIELDS"]))]
    if not all(0 < count <= _MOST_NUMBERS for count in counts):
        raise ValueError(f"COUNT {' '.join(map(str, counts))}")
    names, types = [], []
    fields = zip(entries["FIELDS"], entries["TYPE"], entries["SIZE"], counts, strict=True)
    for name, kind, size, count in fields:
        names += [name] * count
        types += [_PCD_TYPES[f"{kind} {size}"]] * count
    form = entries["DATA"][0]
    if form not in _PCD_FORMS:
        raise ValueError(f"DATA {form} cannot be read, only {', '.join(_PCD_FORMS)}")
    packed = counts if form == "binary_compressed" else []
    return _Layout(int(entries["POINTS"][0]), names, types, form == "ascii", packed)


def _ply(header: list[list[str]]) -> _Layout:
    """Read a PLY header; ValueError, KeyError or IndexError if invalid."""
    lines = [line for line in header[1:-1] if line[0] not in ("comment", "obj_info")]
    order = _PLY_ORDER[lines[0][1]]
    if lines[1][:2] != ["element", "vertex"]:
        raise ValueError(f"{' '.join(lines[1])} comes before the vertices")
    names, types = [], []
    for line in lines[2:]:
        if line[0] == "element":
            break
        _, kind, name = line
        names.append(name)
        types.append(order + _PLY_TYPES[kind])
    return _Layout(int(lines[1][2]), names, types, not order)


def _points(layout: _Layout, data: bytes, begin: int) -> Floats:
    """Return x, y and z of all points (n, 3); ValueError if some are missing."""
    if missing := [axis for axis in "xyz" if axis not in layout.names]:
        raise ValueError(f"no field {', '.join(missing)}")
    axes = [layout.names.index(axis) for axis in "xyz"]
    if layout.count <= 0:
        return np.empty((0, 3))
    if layout.count > MAX_POINTS:
        raise ValueError(f"{layout.count} points, more than {MAX_POINTS}")
    if layout.text:
        lines = data[begin:].split(b"\n", layout.count)[: layout.count]
        rows = [line.decode("ascii") for line in lines]
        filled = any(row.strip() for row in rows)
        table = np.loadtxt(rows, comments=None, ndmin=2) if filled else np.empty((0, 0))
        if table.shape != (layout.count, len(layout.names)):
            raise ValueError(f"{len(table)} of {layout.count} points")
        return np.asarray(table[:, axes])
    if layout.fields:
        return _packed_columns(layout, data[begin:], axes)
    row = np.dtype([(f"f{k}", kind) for k, kind in enumerate(layout.types)])
    whole = (len(data) - begin) // row.itemsize
    if whole < layout.count:
        raise ValueError(f"{whole} of {layout.count} points")
    points = np.frombuffer(data, row, layout.count, begin)
    return np.column_stack([points[f"f{k}"] for k in axes]).astype(np.float64)


def _packed_columns(layout: _Layout, data: bytes, axes: list[int]) -> Floats:
    """Return some numbers (n, len(axes)) of all points; ValueError if the data do not fit."""
    from relmap.datasets.lzf_kernels import unpacked_lzf

    n, types = layout.count, [np.dtype(kind) for kind in layout.types]
    field_of = np.repeat(np.arange(len(layout.fields)), layout.fields)
    width = np.bincount(field_of, [kind.itemsize for kind in types]).astype(np.int64)
    packed, size = _LZF_SIZES.unpack_from(data.ljust(_LZF_SIZES.size, b"\0"))
    if size != n * width.sum() or size > MAX_BYTES or len(data) < _LZF_SIZES.size + packed:
        raise ValueError(f"{size // width.sum()} of {n} points, packed to {packed} bytes")
    unpacked = unpacked_lzf(data[_LZF_SIZES.size :][:packed], size)
    parts = np.split(unpacked, n * np.cumsum(width)[:-1])
    columns = [parts[field_of[k]].view(types[k]).reshape(n, -1)[:, 0] for k in axes]
    return np.column_stack(columns).astype(np.float64)
