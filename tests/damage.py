"""Random damage to valid files, and malicious files."""

from __future__ import annotations

import gzip
import io
import lzma
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.hostile import Files, packed, scans
from tests.scanlogs import CLOUD, pcd, ply

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


def made_to_harm(canary: Path) -> dict[str, Files]:
    """Return files that random damage does not produce, by reader and kind.

    They contain executable code, or fewer data than declared.
    """
    large = io.BytesIO()
    with zipfile.ZipFile(large, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("points", "iteration", "stamps_s"):
            header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3000000000, 3), }"
            archive.writestr(
                f"{name}.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
            )
    deep = b"[" * 60_000  # in a line that is not too long
    cloud = pcd(CLOUD, declared=3_000_000_000)
    return {
        "scans-npz": {
            "objects": scans(points=np.array([Canary(canary)], dtype=object)),
            "pickle": pickle.dumps(Canary(canary)),
            "billions": large.getvalue(),
        },
        "point-clouds-0.pcd": {"billions": cloud, "text": cloud.replace(b"binary", b"ascii")},
        "point-clouds-1.ply": {"billions": ply(CLOUD, declared=3_000_000_000)},
        "config": {"deep": b"a = " + deep, "long": b"group_after = " + b"9" * 5000},
        "result-summary.json": {
            "deep": b'{"scans": ' + deep,
        },
    }


def packed_rows(head: bytes, row: bytes, size: int) -> bytes:
    """Return one row repeated up to so many bytes, gzipped."""
    many = row * ((1 << 20) // len(row))
    stream = io.BytesIO()
    with gzip.GzipFile(fileobj=stream, mode="wb", compresslevel=1, mtime=0) as file:
        file.write(head)
        for _ in range(size // len(many)):
            file.write(many)
    return stream.getvalue()
