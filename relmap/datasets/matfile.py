"""Numeric matrices in MATLAB files of level 5, robust against damaged files.

They are not read by scipy, whose reader crashes the program on some damaged files and unpacks any
stated size (version 1.17).  The format: "MAT-File Format", MathWorks, chapter 1; a header of 128
bytes, then elements, each a tag of type and size with its data.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats
from relmap.datasets.textfile import invalid, quoted

MAX_BYTES = 1 << 28
"""Limit of the unpacked size, 256 MiB: a hundred times the largest file in use."""
MAX_NUMBERS = 1 << 24
"""Maximum number of values in a matrix."""

_MAGIC = b"MATLAB 5.0 MAT-file"
_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_NUMBERS |= {12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX = 0x0800


def read_matrix(file: Path, name: str) -> Floats:
    """Return a matrix of real numbers from a MATLAB file; RelmapError if it holds none."""
    try:
        with open(file, "rb") as stream:
            data = stream.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise ValueError(f"more than {MAX_BYTES} bytes")
        order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER_BYTES])
        if data[: len(_MAGIC)] != _MAGIC or order is None:
            packed = data.startswith(b"\x1f\x8b")
            raise ValueError("packed by gzip" if packed else "not of level 5")
        for content in _matrices(memoryview(data)[_HEADER_BYTES:], order):
            matrix = _matrix(content, order, name)
            if matrix is not None:
                return matrix
        raise ValueError(f"it holds no {name}")
    except (OSError, ValueError, zlib.error) as error:
        reason = quoted(getattr(error, "strerror", None) or str(error))
        problem = f"cannot be read: {reason}"
        raise invalid(file, f"{problem}, expected a MATLAB file with {name}") from error


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield type and content of each element; ValueError if one exceeds the data."""
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise ValueError("cut short")
        kind, size = (int(word) for word in np.frombuffer(data, f"{order}u4", 2, at))
        begin = at + 8
        if kind >> 16:  # a small element, packed into its tag
            kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise ValueError("a small element of more than 4 bytes")
        if begin + size > len(data):
            raise ValueError("cut short")
        yield kind, data[begin : begin + size]
        at = begin + max(size, 4) if begin == at + 4 else begin + size
        if kind != _COMPRESSED:
            at += -at % 8


def _matrices(data: memoryview, order: str) -> Iterator[memoryview]:
    """Yield the unpacked content of each matrix of a file."""
    room = MAX_BYTES
    for kind, content in _elements(data, order):
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(content, room)
            room -= len(unpacked)
            if room <= 0:
                raise ValueError(f"more than {MAX_BYTES} bytes when unpacked")
            for kind_within, within in _elements(memoryview(unpacked), order):
                if kind_within == _MATRIX:
                    yield within
        elif kind == _MATRIX:
            yield content


def _matrix(content: memoryview, order: str, name: str) -> Floats | None:
    """Return a matrix if it has the given name; ValueError if it is not numeric."""
    parts = _elements(content, order)
    try:
        flags = np.frombuffer(next(parts)[1], f"{order}u4")
        shape = [int(length) for length in np.frombuffer(next(parts)[1], f"{order}i4")]
        if bytes(next(parts)[1]) != name.encode():
            return None
        kind, numbers = next(parts)
    except StopIteration:
        raise ValueError("a matrix without numbers") from None
    real = len(flags) == 2 and flags[0] & 0xFF in _NUMERIC_CLASSES and not flags[0] & _COMPLEX
    if not real or kind not in _NUMBERS or len(shape) != 2 or min(shape) < 1:
        raise ValueError(f"{name} is not a matrix of numbers")
    if math.prod(shape) > MAX_NUMBERS:
        raise ValueError(f"{name} has more than {MAX_NUMBERS} numbers")
    values = np.frombuffer(numbers, order + _NUMBERS[kind])
    return np.asarray(values.reshape(shape, order="F"), dtype=np.float64)
