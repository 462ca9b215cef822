"""Arrays in ``.npz`` files that may be damaged or malicious.

They are not read by numpy (2.4), which allocates any size stated in a header and evaluates the
header as Python, so that a damaged one raises tokeniser errors.
"""

from __future__ import annotations

import math
import re
import struct
import zipfile
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_NUMBERS = 1 << 26
"""Maximum number of values in an array: 22 million points."""

DAMAGE = (
    *(OSError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error, struct.error),
    *(ValueError, TypeError, LookupError),
)
"""Exceptions raised for damaged files."""

_HEADER_BYTES = 10_000
_HEADER = re.compile(
    rb"\{'descr': *'([<>|=]?[biufcSU][0-9]{1,5})', *'fortran_order': *(True|False), *"
    rb"'shape': *\(((?:[0-9]{1,12}(?:, *|(?=\)))){0,8})\),? *\} *\n?"
)


def read_array(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, most: int = MAX_NUMBERS
) -> NDArray[Any]:
    """Return a member as a numeric array; raises one of `DAMAGE` if it is not one.

    Headers are matched against numpy's format, never evaluated.
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{member.filename} is packed in a way that numpy does not use")
    with archive.open(member) as stream:
        magic = stream.read(8)
        width = 2 if magic[6:] == b"\x01\x00" else 4
        length = int.from_bytes(stream.read(width), "little")
        if magic[:6] != b"\x93NUMPY" or length > _HEADER_BYTES:
            raise ValueError(f"{member.filename} is not an array")
        header = _HEADER.fullmatch(stream.read(length))
        if header is None:
            raise ValueError(f"{member.filename} is not an array of numbers")
        dtype = np.dtype(header[1].decode())
        shape = [int(side) for side in header[3].split(b",") if side.strip()]
        size = math.prod(shape) * dtype.itemsize
        if math.prod(shape) > most or size > member.file_size:
            raise ValueError(
                f"{member.filename} does not hold the {shape} numbers that its header states"
            )
        array = np.frombuffer(stream.read(size), dtype)
    return array.reshape(shape, order="F" if header[2] == b"True" else "C")
