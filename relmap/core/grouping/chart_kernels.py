"""The point chart with its observations, compiled; see `relmap.core.grouping.chart`."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled, helper
from relmap.core.linalg.order_kernels import ordered


@compiled
def seen_with(landmarks: Ints, offsets: Ints, seed: int, slots: Ints) -> tuple[Ints, Ints]:
    """Return the landmarks seen with a seed, the seed first, and when; see `chart_block`."""
    columns, j = np.empty(len(offsets) - 1, dtype=np.int64), 0
    members, n = np.empty(len(landmarks) + 1, dtype=np.int64), 0
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
                    slots[landmarks[row]] = 0
                    members[n] = landmarks[row]
                    n += 1
    for k in range(n):
        slots[members[k]] = -1
    return members[:n], columns[:j]


@compiled
def chart_block(
    landmarks: Ints, points: Floats, offsets: Ints, members: Ints, columns: Ints, slots: Ints
) -> Floats:
    """Chart the observations of members (n,) in some iterations.

    `landmarks` (k,); `points` (k, d): observations in order of iteration. `offsets` (i + 1,): first
    observation of each iteration, and the end. `columns` (j,): iterations, counted from the first,
    which show no other landmarks. `slots` (m,): work space, one entry per landmark, all -1;
    restored on return. Returns the block (n, j, d): NaN where missing.
    """
    block = np.empty((len(members), len(columns), points.shape[1]))
    block[:] = np.nan
    for k in range(len(members)):
        slots[members[k]] = k
    for column in range(len(columns)):
        i = columns[column]
        for row in range(offsets[i], offsets[i + 1]):
            for a in range(points.shape[1]):
                block[slots[landmarks[row]], column, a] = points[row, a]
    for k in range(len(members)):
        slots[members[k]] = -1
    return block


@helper
def _descending(rows: Ints, values: Floats | Ints) -> Ints:
    """Return rows (k,) in the order of their descending values, equal ones as they are."""
    keys, listed = np.empty(len(rows)), np.empty(len(rows), dtype=np.int64)
    for j in range(len(rows)):
        keys[j] = -values[rows[j]]
    order = ordered(keys)
    for j in range(len(rows)):
        listed[j] = rows[order[j]]
    return listed


@helper
def _still_common(block: Floats, row: int, common: Ints, n: int) -> int:
    """Keep those of n columns of a block (n, i, d) that show a row; return how many."""
    left = 0
    for i in range(n):
        if not np.isnan(block[row, common[i], 0]):
            common[left], left = common[i], left + 1
    return left


@compiled
def grown(
    block: Floats, candidates: Ints, counts: Ints, weights: Floats, fewest: tuple[int, int]
) -> tuple[Ints, Ints, Floats]:
    """Grow a group from candidates (c,), rows of a block (n, i, d); see `chart.grow_group`.

    `counts`, `weights` (n,): common interval and weight in the map of each row; `fewest`: minimum
    number of members, and of mapped ones. Returns the members (g,), the columns (k,) of their
    common interval, and their observations (g, k, d); no members if there is no group.
    """
    c, m, d = len(candidates), block.shape[1], block.shape[2]
    rows = _descending(_descending(candidates, weights), counts)
    common, n_common, shared, best, area = np.empty(m, dtype=np.int64), m, 0, 0, 0
    columns, n_columns = np.empty(m, dtype=np.int64), 0
    for i in range(m):
        common[i] = i
    for j in range(c):
        shared += weights[rows[j]] > 0
        n_common = _still_common(block, rows[j], common, n_common)
        if c * n_common <= area:  # no larger one further down
            break
        if j + 1 >= fewest[0] and shared >= fewest[1] and (j + 1) * n_common > area:
            best, area, n_columns = j + 1, (j + 1) * n_common, n_common
            for i in range(n_common):
                columns[i] = common[i]
    core = np.empty((best, n_columns, d))
    for j in range(best):
        for i in range(n_columns):
            for a in range(d):
                core[j, i, a] = block[rows[j], columns[i], a]
    return rows[:best], columns[:n_columns], core
