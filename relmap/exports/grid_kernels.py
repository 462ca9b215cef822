"""Beams through the cells of a grid, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Ints
from relmap.core.linalg.compiling import compiled


@compiled
def cast(begins: NDArray[Any], ends: NDArray[Any], passed: Ints, ended: Ints) -> None:
    """Count the cells in which lines end, and those through which they pass before.

    A line is followed only until it leaves the grid.

    `begins`, `ends` (n, 2): in units of cells: the cell in row i and column j reaches from (j, i)
    to (j + 1, i + 1); `passed`, `ended` (rows, columns): counts, incremented in place.
    """
    rows, columns = passed.shape
    for k in range(len(begins)):
        x, y = begins[k]
        dx, dy = ends[k, 0] - x, ends[k, 1] - y
        j, i = int(np.floor(x)), int(np.floor(y))
        last_j, last_i = int(np.floor(ends[k, 0])), int(np.floor(ends[k, 1]))
        right, up = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        # Position along the line, as a fraction, of the next column and the next row.
        next_x = ((j + (dx > 0)) - x) / dx if dx != 0 else np.inf
        next_y = ((i + (dy > 0)) - y) / dy if dy != 0 else np.inf
        for _ in range(abs(last_j - j) + abs(last_i - i)):
            if not (0 <= i < rows and 0 <= j < columns):
                break
            passed[i, j] += 1
            if next_x < next_y:
                j, next_x = j + right, next_x + right / dx
            else:
                i, next_y = i + up, next_y + up / dy
        if i == last_i and j == last_j and 0 <= i < rows and 0 <= j < columns:
            ended[i, j] += 1
