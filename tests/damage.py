"""Random damage to valid files, and files that are malicious or large."""

from __future__ import annotations

import gzip
import io
import lzma
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from tests.hostile import CIRCLES, Files, mat, npz, packed, scans
from tests.scanlogs import CLOUD, LASER, pcd, ply

GIB = 1 << 30
Mutation = Callable[[bytes, np.random.Generator], bytes]


class Canary:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


WORDS = [
    *(b"nan", b"inf", b"-inf", b"1e999", b"-1e308", b"1e9", b"0", b"-0.0", b"-1", b"", b" "),
    *(b"9223372036854775807", b"18446744073709551616", b"4294967295", b"3000000000", b"1e-320"),
    *(b"9" * 5000, b"0x10", b"1_000", b"1,5", b"None", b"true", b"\xff\xfe", b"\x00", b"\xc3\xa9"),
    *(b"[" * 100_000, b'{"a":' * 50_000, b"\n" * 1000, b"a" * 70_000, b"../../etc/passwd"),
    *("٣".encode(), "\uff11".encode(), b"static", b"corner", b"{}", b"[]", b"null", b"\r", b'"'),
]
_SEPARATES = np.isin(np.arange(256), list(b" ,\n;=:[]"))
"""Whether each byte separates words."""
HEADS = [
    *(
        b"PK\x03\x04",
        b"\x1f\x8b\x08",
        b"\xfd7zXZ\x00",
        b"\x93NUMPY\x01\x00",
        b"MATLAB 5.0 MAT-file",
    ),
    *(b"ply\nformat ascii 1.0\n", b"# .PCD v0.7\nVERSION 0.7\n", b"FLASER 2 1 ", b"STEP 1 2 "),
    *(b"iteration,x,y\n", b"\xef\xbb\xbf", b"\xff\xfe", b"%PDF-1.7\n", b"\x7fELF", b"{", b"scan,"),
]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for at in rng.integers(0, max(len(data), 1), rng.integers(1, 8)).tolist():
        if data:
            changed[at] = int(rng.integers(256))
    return bytes(changed)


def _without(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    return data[:begin] + data[end:]


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Double, swap, leave out or shuffle lines."""
    lines = data.split(b"\n")
    order = np.arange(len(lines))
    a, b = rng.integers(len(lines), size=2)
    kind = rng.integers(4)
    if kind == 0:
        order = np.insert(order, a, order[b])
    elif kind == 1:
        order[[a, b]] = order[[b, a]]
    elif kind == 2:
        order = np.delete(order, a)
    else:
        order = rng.permutation(order)
    return b"\n".join(lines[k] for k in order)


def _word(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace the text between two separators, or one byte, by a harmful word."""
    word = WORDS[rng.integers(len(WORDS))]
    separators = np.flatnonzero(_SEPARATES[np.frombuffer(data, np.uint8)]).tolist()
    if not separators:
        at = int(rng.integers(len(data) + 1))
        return data[:at] + word + data[at + 1 :]
    k = int(rng.integers(len(separators)))
    end = separators[k + 1] if k + 1 < len(separators) else len(data)
    return data[: separators[k] + 1] + word + data[end:]


def _headed(data: bytes, rng: np.random.Generator) -> bytes:
    return HEADS[rng.integers(len(HEADS))] + (data if rng.integers(2) else _cut(data, rng))


def _number(data: bytes, rng: np.random.Generator) -> bytes:
    """Overwrite 2, 4 or 8 bytes by a small, large or negative number."""
    width = int(rng.choice([2, 4, 8]))
    value = int(rng.choice([0, 1, -1, 2**31 - 1, -(2**31), 2**15, 2**40, 2**63 - 1]))
    at = int(rng.integers(len(data) + 1))
    return data[:at] + (value % (1 << 8 * width)).to_bytes(width, "little") + data[at + width :]


MUTATIONS: tuple[Mutation, ...] = (_cut, _flipped, _without, _lines, _word, _word, _headed, _number)


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return data damaged in one to three ways; half of what is gzipped is damaged inside."""
    if data[:2] == b"\x1f\x8b" and rng.integers(2):
        return packed(mutated(gzip.decompress(data), rng))
    if data[:4] == b"PK\x03\x04" and rng.integers(2):
        return _mutated_zip(data, rng)
    if data[:6] == b"\xfd7zXZ\x00" and rng.integers(2):
        return lzma.compress(mutated(lzma.decompress(data), rng), preset=0)
    for _ in range(rng.integers(1, 4)):
        data = MUTATIONS[rng.integers(len(MUTATIONS))](data, rng)
    return data


def _mutated_zip(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a valid zip file with a member damaged, renamed or left out."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(stream, "w") as new:
        names = old.namelist()
        chosen = names[rng.integers(len(names))]
        for name in names:
            content = old.read(name)
            if name == chosen:
                content = mutated(content, rng)
                name = [name, f"../{name}", f"/{name}", "x"][rng.integers(4)]
            new.writestr(name, content)
    return stream.getvalue()


def npz_made_to_harm(canary: Path) -> Files:
    """Return scans.npz that contain executable code, or fewer data than declared."""
    large = io.BytesIO()
    with zipfile.ZipFile(large, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("points", "iteration", "stamps_s"):
            header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3000000000, 3), }"
            archive.writestr(
                f"{name}.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
            )
    return {
        "objects": scans(points=np.array([Canary(canary)], dtype=object)),
        "pickle": pickle.dumps(Canary(canary)),
        "billions": large.getvalue(),
    }


def made_to_harm(canary: Path) -> dict[str, Files]:
    """Return files that random damage does not produce, by reader and kind."""
    deep = b"a = " + b"[" * 100_000
    cloud = pcd(CLOUD, declared=3_000_000_000)
    return {
        "scans-npz": npz_made_to_harm(canary) | {"zeros": _deflated_scans(8 * GIB)},
        "point-clouds-0.pcd": {"billions": cloud, "text": cloud.replace(b"binary", b"ascii")},
        "point-clouds-3.pcd": {"zeros": _packed_zeros(12 << 23)},
        "point-clouds-1.ply": {"billions": ply(CLOUD, declared=3_000_000_000)},
        "point-clouds-2.pcd.xz": {"zeros": lzma.compress(pcd(CLOUD) + bytes(GIB // 2), preset=0)},
        "config": {"deep": deep, "long": b"group_after = " + b"9" * 5000},
        "result-summary.json": {
            "deep": b'{"scans": ' + b"[" * 100_000,
            "format": b'{"association": "known", "scans": [0, 14], "input": "gone", "format": [1]}',
        },
        "slsjf-sim": {"zeros": _zeros_mat("sensor_data", GIB // 2)},
        "observation-csv": {
            "zeros": packed_zeros(2 * GIB),
            "rows": packed_rows(b"iteration,x,y\n", b"0,0,0\n", GIB),
        },
        "dlr-circles": {"rows": packed_rows(CIRCLES.encode(), b"LANDMARK_C 1 2 0 1 0 1 5\n", GIB)},
        "relations": {"rows": packed_rows(b"", b"1 2 0 0 0 0 0 0\n", GIB)},
        "carmen-log-corrected": {
            "rows": packed_rows(b"", b"FLASER 9 1 1 1 1 1 1 1 1 1 0 0 0 0 0 0 1 h 1\n", GIB)
        },
        "mrpt-laser2d": {"rows": packed_rows(LASER.encode(), b"12,1,2,0,0,0,0,1,2,3\n", GIB)},
        "result-tracks.csv.gz": {"rows": packed_rows(b"iteration,row,landmark\n", b"0,0,0\n", GIB)},
        "result-trajectory.tum": {"rows": packed_rows(b"", b"0 0 0 0 0 0 0 1\n", GIB)},
        "truth/landmarks.csv": {
            "rows": packed_rows(b"landmark,x,y,z,status\n", b"0,0,0,0,\n", GIB)
        },
    }


def nearly_too_large() -> dict[str, Files]:
    """Return files just within the limits, which are read, or refused for their content."""
    scan = b"FLASER 60 " + b"1 " * 60 + b"0 0 0 0 0 0 1 h 1\n"
    cloud = b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS 8000000\nDATA ascii\n"
    n = 12_000_000
    points = np.ones((n, 3)), np.zeros(n, dtype=np.int64), np.zeros(1)
    return {
        "observation-csv": {
            "most": packed_rows(b"iteration,x,y\n", b"0,0,0\n", 6 * 9_900_000),
            "numbers": packed_rows(b"iteration,x,y,z,id\n", b"0,0,0,0,-1\n", 11 * 6_600_000),
        },
        "dlr-circles": {
            "most": packed_rows(CIRCLES.encode(), b"LANDMARK_C 1 2 0 1 0 1 5\n", 25 * 4_100_000)
        },
        "relations": {"most": packed_rows(b"", b"1 2 0 0 0 0 0 0\n", 16 * 2_000_000)},
        "carmen-log-corrected": {"most": packed_rows(b"", scan, len(scan) * 262_000)},
        "mrpt-laser2d": {
            "most": packed_rows(LASER.encode(), b"12,1,2,0,0,0,0,1,2,3\n", 21 * 3_300_000)
        },
        "result-tracks.csv.gz": {
            "most": packed_rows(b"iteration,row,landmark\n", b"0,0,0\n", 6 * 9_900_000)
        },
        "result-trajectory.tum": {"most": packed_rows(b"", b"0 0 0 0 0 0 0 1\n", 16 * 2_000_000)},
        "result-summary.json": {"most": packed_rows(b"[1", b",[]", 60_000_000)},
        "truth/landmarks.csv": {
            "most": packed_rows(b"landmark,x,y,z,status\n", b"0,0,0,0,static\n", 15 * 9_900_000)
        },
        "point-clouds-0.pcd": {"most": cloud + b"1 2 3\n" * 8_000_000},
        "scans-npz": {"most": npz(points=points[0], iteration=points[1], stamps_s=points[2])},
        "slsjf-sim": {"most": _zeros_mat("sensor_data", 8 << 24)},
    }


def _packed_zeros(size: int) -> bytes:
    """Return a cloud of so many bytes of zeros, packed by LZF."""
    more, rest = divmod(size - 1, 264)
    packed = b"\0\0" + b"\xe0\xff\0" * more + bytes([rest - 1, *bytes(rest)])
    n = size // 12
    header = pcd(CLOUD, declared=n).partition(b"DATA")[0]
    sizes = np.array([len(packed), 12 * n], dtype="<u4").tobytes()
    return header + b"DATA binary_compressed\n" + sizes + packed


def packed_zeros(size: int) -> bytes:
    return packed_rows(b"", bytes(1 << 16), size)


def packed_rows(head: bytes, row: bytes, size: int) -> bytes:
    """Return one row repeated up to so many bytes, gzipped."""
    many = row * ((1 << 20) // len(row))
    stream = io.BytesIO()
    with gzip.GzipFile(fileobj=stream, mode="wb", compresslevel=1, mtime=0) as file:
        file.write(head)
        for _ in range(size // len(many)):
            file.write(many)
    return stream.getvalue()


def _deflated_scans(size: int) -> bytes:
    """Return scans whose points are zeros of so many bytes."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({size // 24}, 3), }}".encode()
    stream = io.BytesIO(scans())
    result = io.BytesIO()
    with (
        zipfile.ZipFile(stream) as old,
        zipfile.ZipFile(result, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as new,
    ):
        for name in old.namelist():
            if name != "points.npy":
                new.writestr(name, old.read(name))
        with new.open("points.npy", "w", force_zip64=True) as member:
            member.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
            for _ in range(size // GIB):
                for _ in range(64):
                    member.write(bytes(GIB // 64))
    return result.getvalue()


def _zeros_mat(name: str, size: int) -> bytes:
    zeros: dict[str, Floats] = {name: np.zeros((size // 56, 7))}
    return mat(True, **zeros)
