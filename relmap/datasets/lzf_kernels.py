"""LZF decompression, for PCD files in ``binary_compressed`` form.

A control byte below 32 begins a literal run of that length plus one; any other is a back reference:
the upper three bits are its length minus 2 (7: the next byte is added), the rest and the following
byte its distance minus 1. The format: M. Lehmann, liblzf.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled

MOST_TIMES = 88
"""Maximum expansion: three bytes unpack to at most 264."""


def unpacked_lzf(data: bytes, size: int) -> NDArray[np.uint8]:
    """Return the `size` bytes that data unpacks to; ValueError if damaged."""
    if size > MOST_TIMES * len(data):
        raise ValueError(f"{len(data)} packed bytes for {size}, more than LZF can")
    result = np.empty(size, dtype=np.uint8)
    if not _unpack(np.frombuffer(data, np.uint8), result):
        raise ValueError(f"LZF data that do not unpack to {size} bytes")
    return result


@compiled
def _unpack(data: NDArray[np.uint8], result: NDArray[np.uint8]) -> bool:
    """Unpack data (m,) and return whether it fills the result (n,) exactly."""
    at, done, m, n = 0, 0, len(data), len(result)
    while at < m:
        control = int(data[at])
        at += 1
        if control < 32:
            length, first = control + 1, at
            at += length
            if at > m or done + length > n:
                return False
            for k in range(length):
                result[done + k] = data[first + k]
        else:
            length = control >> 5
            if length == 7 and at < m:
                length += int(data[at])
                at += 1
            length += 2
            if at >= m or done + length > n:
                return False
            first = done - ((control & 31) << 8) - int(data[at]) - 1
            at += 1
            if first < 0:
                return False
            for k in range(length):  # byte by byte: a back reference may overlap its own output
                result[done + k] = result[first + k]
        done += length
    return done == n
