"""One-to-one assignments of maximum score, compiled."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.linalg.compiling import helper
from relmap.core.linalg.small_kernels import unset


@helper
def _cheapest_path(
    worth: Floats,
    start: int,
    column_of: Ints,
    price_column: Floats,
    price_row: Floats,
    work: tuple[Floats, Ints, Bools],
) -> int:
    """Find the shortest path from a column to a free row, and update the prices (Dijkstra).

    `work` are a distance, the predecessor on the path, and whether it is known, of each row.
    Returns the free row.
    """
    n, rows = len(worth), len(price_row)
    least, before, done = work
    for r in range(rows):
        least[r], before[r], done[r] = np.inf, -1, False
    column, last = start, -1
    while column >= 0:
        best, row = np.inf, -1
        for r in range(rows):
            if not done[r]:
                cost = -worth[r, column] if r < n else 0.0
                reach = cost - price_column[column] - price_row[r]
                if reach < least[r]:
                    least[r], before[r] = reach, last
                if least[r] < best:
                    best, row = least[r], r
        price_column[start] += best
        for r in range(rows):
            if done[r]:
                price_column[column_of[r]] += best
                price_row[r] -= best
            else:
                least[r] -= best
        done[row], last, column = True, row, column_of[row]
    return last


@helper
def assigned(worth: Floats) -> Ints:
    """Return the row of each column for a one-to-one assignment of maximum total score (n, m).

    -1 if a column has none, or one with score 0. Shortest augmenting paths (Jonker and Volgenant,
    1987), padded with rows of score 0 if there are more columns.
    """
    n, m = worth.shape
    rows = max(n, m)
    column_of, price_column, price_row = unset(rows), np.zeros(m), np.zeros(rows)
    before = unset(rows)
    work = np.empty(rows), before, np.zeros(rows, dtype=np.bool_)
    for start in range(m):
        last = _cheapest_path(worth, start, column_of, price_column, price_row, work)
        while last >= 0:
            row, last = last, before[last]
            column_of[row] = column_of[last] if last >= 0 else start
    row_of = unset(m)
    for r in range(n):
        if column_of[r] >= 0 and worth[r, column_of[r]] > 0:
            row_of[column_of[r]] = r
    return row_of
