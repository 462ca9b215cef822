"""The point chart with its observations, compiled; see `relmap.core.grouping.chart`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper


@helper
def _members_and_columns(
    landmarks: Ints, offsets: Ints, seed: int, slots: Ints
) -> tuple[Ints, Ints]:
    """Return the landmarks seen with a seed, the seed first, and when; number them in the slots."""
    columns, members = np.empty(len(offsets) - 1, np.int64), np.empty(len(landmarks) + 1, np.int64)
    j, n = 0, 0
    if seed >= 0:
        members[0], slots[seed], n = seed, 0, 1
    for i in range(len(offsets) - 1):
        with_seed = seed < 0
        for row in range(offsets[i], offsets[i + 1]):
            with_seed |= landmarks[row] == seed
        if with_seed:
            columns[j] = i
            j += 1
            for row in range(offsets[i], offsets[i + 1]):
                if slots[landmarks[row]] < 0:
                    slots[landmarks[row]] = n
                    members[n] = landmarks[row]
                    n += 1
    return members[:n], columns[:j]


@compiled
def chart_block(
    landmarks: Ints, points: Floats, offsets: Ints, seed: int, slots: Ints
) -> tuple[Ints, Ints, Floats]:
    """Chart the observations of the iterations in which a seed was seen.

    `landmarks` (k,); `points` (k, d): observations in order of iteration. `offsets` (i + 1,): first
    observation of each iteration, and the end. `seed`: -1 for the observations of all iterations.
    `slots` (m,): work space, one entry per landmark, all -1; restored on return. Returns
    `landmarks` (n,): the seed, if any, then the others in order of first observation, `columns`
    (j,): iterations, counted from the first and `block` (n, j, d): NaN where missing.
    """
    members, columns = _members_and_columns(landmarks, offsets, seed, slots)
    block = np.empty((len(members), len(columns), points.shape[1]))
    block[:] = np.nan
    for column in range(len(columns)):
        i = columns[column]
        for row in range(offsets[i], offsets[i + 1]):
            for a in range(points.shape[1]):
                block[slots[landmarks[row]], column, a] = points[row, a]
    for k in range(len(members)):
        slots[members[k]] = -1
    return members, columns, block
