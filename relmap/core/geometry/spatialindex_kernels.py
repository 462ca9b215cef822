"""The lists of a spatial index, compiled; see `spatialindex`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Counts, Floats, Ints
from relmap.core.linalg.compiling import compiled, helper

Grid = tuple[Counts, Counts, Ints, Ints]
"""First landmark of each bucket; of the landmark table: next_in_cell, cell, last."""

AXIS = 20
"""Bits of a key for each axis: more distant cells share their keys."""
FARTHEST = 2.0**62
"""Largest index of a cell."""
MIX = 0x1E3779B97F4A7C15
"""Spreads the keys over the buckets (Knuth, "The Art of Computer Programming", 6.4)."""


@helper
def cell_at(place: float, cell_m: float) -> int:
    """Return the index of the cell of a coordinate, along one axis."""
    return int(min(max(np.floor(place / cell_m), -FARTHEST), FARTHEST))


@helper
def key_of(x: int, y: int, z: int) -> int:
    """Return the key of a cell, 0 or more."""
    mask = (1 << AXIS) - 1
    return (x & mask) | ((y & mask) << AXIS) | ((z & mask) << (2 * AXIS))


@helper
def bucket_of(key: int, n: int) -> int:
    """Return the bucket of a key, of n, a power of two."""
    return ((key * MIX) >> 32) & (n - 1)


@helper
def _remove(first: Counts, following: Counts, one: int, bucket: int) -> None:
    if first[bucket] == one:
        first[bucket] = following[one]
        return
    other = first[bucket]
    while following[other] != one:
        other = following[other]
    following[other] = following[one]


@compiled
def enter(
    first: Counts, columns: tuple[Counts, Ints, Floats, Floats], landmarks: Ints, cell_m: float
) -> int:
    """Insert those of landmarks (k,) that are mapped; return how many were not in the index.

    `first` (n,) is the first landmark of each bucket, n a power of two. `columns`, of the landmark
    table: next_in_cell and cell, -1 for none; position, weight.
    """
    following, key, position, weight = columns
    n_new = 0
    for one in landmarks:
        if weight[one] == 0:
            continue
        x, y = cell_at(position[one, 0], cell_m), cell_at(position[one, 1], cell_m)
        now = key_of(x, y, cell_at(position[one, 2], cell_m) if position.shape[1] == 3 else 0)
        if now == key[one]:
            continue
        if key[one] >= 0:
            _remove(first, following, one, bucket_of(key[one], len(first)))
        else:
            n_new += 1
        bucket = bucket_of(now, len(first))
        following[one], first[bucket], key[one] = first[bucket], one, now
    return n_new


@compiled
def link(first: Counts, following: Counts, key: Ints) -> int:
    """Link all landmarks in the index anew, for another number of buckets; return how many."""
    n = 0
    for one in range(len(key)):
        if key[one] >= 0:
            bucket = bucket_of(key[one], len(first))
            following[one], first[bucket] = first[bucket], one
            n += 1
    return n


@helper
def _enter_near(
    grid: Grid, position: Floats, cell_m: float, before: int, found: Ints, n: int
) -> int:
    """Write the landmarks near a position (d,) from entry n of `found` (r,) on; see `near`.

    Returns the end of them, which is beyond the last entry if there is no room for all.
    """
    first, following, key, last = grid
    layers = 3 if len(position) == 3 else 1
    x, y = cell_at(position[0], cell_m), cell_at(position[1], cell_m)
    z = cell_at(position[2], cell_m) - 1 if layers == 3 else 0
    for around in range(9 * layers):
        wanted = key_of(x + around % 3 - 1, y + around // 3 % 3 - 1, z + around // 9)
        one = first[bucket_of(wanted, len(first))]
        while one >= 0:
            if key[one] == wanted and last[one] < before:
                if n < len(found):
                    found[n] = one
                n += 1
            one = following[one]
    return n


@compiled
def near(grid: Grid, positions: Floats, cell_m: float, before: Ints) -> tuple[Ints, Ints]:
    """Return the pairs of a position (k, d) and a landmark in its cell or one beside it.

    Only landmarks last seen `before` (k,) an iteration.
    """
    begin, found = np.zeros(len(positions) + 1, dtype=np.int64), np.empty(64, dtype=np.int64)
    for k in range(len(positions)):
        end = _enter_near(grid, positions[k], cell_m, before[k], found, begin[k])
        if end > len(found):
            fuller = np.empty(2 * end, dtype=np.int64)
            for i in range(begin[k]):
                fuller[i] = found[i]
            found = fuller
            end = _enter_near(grid, positions[k], cell_m, before[k], found, begin[k])
        begin[k + 1] = end
    of = np.empty(begin[-1], dtype=np.int64)
    for k in range(len(positions)):
        for i in range(begin[k], begin[k + 1]):
            of[i] = k
    return of, found[: begin[-1]]
