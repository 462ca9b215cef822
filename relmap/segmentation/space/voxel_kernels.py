"""Compiled loops of `relmap.segmentation.space.voxels`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.geometry.spatialindex_kernels import bucket_of
from relmap.core.linalg.compiling import compiled
from relmap.segmentation.space.voxels import BITS, NEAR


@compiled
def numbered_cells(
    points: Floats, range_m: Floats, size_m: float, middle_m: float
) -> tuple[Ints, Ints]:
    """Return the keys (v,) of the voxels of points (n, 3), as they occur, and that of each (n,)."""
    slots = 16
    while slots < 2 * len(points):
        slots *= 2
    slot, half = np.zeros(slots, dtype=np.int64), 1 << (BITS - 1)
    keys, of = np.empty(len(points), dtype=np.int64), np.empty(len(points), dtype=np.int64)
    found, last, v = 0, -1, -1
    for i in range(len(points)):
        scale = np.sqrt(middle_m / max(range_m[i], NEAR * middle_m)) / size_m
        key = 0
        for a in range(3):
            key = (key << BITS) | (int(np.floor(points[i, a] * scale)) + half)
        if key != last:
            at = bucket_of(key, slots)
            # A slot holds the number of its voxel plus one, 0 if it is empty.
            while slot[at] > 0 and keys[slot[at] - 1] != key:
                at = (at + 1) & (slots - 1)
            if slot[at] == 0:
                keys[found], found = key, found + 1
                slot[at] = found
            v, last = slot[at] - 1, key
        of[i] = v
    return keys[:found], of


@compiled
def neighbours(keys: Ints, steps: Ints) -> Ints:
    """Return the voxels (v, s) whose keys differ from those of each by the steps; -1 for none.

    `keys` (v,), ascending; `steps` (s,), ascending: with each step there is its negative.
    """
    count, last = len(keys), len(steps) - 1
    around = np.full((count, len(steps)), -1)
    for k in range(len(steps)):
        if steps[k] < 0:
            continue
        j = 0
        for i in range(count):
            while j < count and keys[j] < keys[i] + steps[k]:
                j += 1
            if j < count and keys[j] == keys[i] + steps[k]:
                around[i, k] = j
                around[j, last - k] = i
    return around
