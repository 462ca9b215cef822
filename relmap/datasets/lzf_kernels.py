"""LZF, as PCD files of the form ``binary_compressed`` are packed.

A control byte below 32 begins a literal run of one byte more; any other repeats what was unpacked
before: the upper three bits are its length less 2 (7: a byte follows that is added), the rest and
the next byte how far back it begins, less 1. The format: M. Lehmann, liblzf.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.linalg.compiling import compiled

MOST_TIMES = 88
"""Three bytes stand for at most 264."""


def unpacked_lzf(data: bytes, size: int) -> NDArray[np.uint8]:
    """Return the `size` bytes that data unpacks to; ValueError where it is damaged."""
    if size > MOST_TIMES * len(data):
        raise ValueError(f"{len(data)} packed bytes for {size}, more than LZF can")
    result = np.empty(size, dtype=np.uint8)
    if not _unpack(np.frombuffer(data, np.uint8), result):
        raise ValueError(f"LZF data that do not unpack to {size} bytes")
    return result


@compiled
def _unpack(data: NDArray[np.uint8], result: NDArray[np.uint8]) -> bool:
    """Unpack data (m,) and tell whether it fills the result (n,) exactly."""
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
            for k in range(length):  # byte by byte: a repetition may run into itself
                result[done + k] = result[first + k]
        done += length
    return done == n
