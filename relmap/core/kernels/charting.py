"""The point chart with its observations, compiled; see `relmap.core.chart`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.kernels import compiled


@compiled
def chart_block(
    landmarks: NDArray[np.int64],
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    seed: int,
    slots: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Chart what was seen in the iterations in which a seed was.

    Parameters
    ----------
    landmarks : (k,) int64
    points : (k, d) float64
        Observations in order of iteration.
    offsets : (i + 1,) int64
        Where those of each iteration begin, and the end.
    seed : int
    slots : (m,) int64
        Room for a number per landmark, all -1; left so.

    Returns
    -------
    landmarks : (n,) int64
        The seed, then the others in ascending order.
    columns : (j,) int64
        Iterations, counted from the first.
    block : (n, j, d) float64
        NaN where a landmark was not seen.
    """
    columns, present = np.empty(len(offsets) - 1, np.int64), np.empty(len(landmarks), np.int64)
    j, n = 0, 0
    for i in range(len(offsets) - 1):
        with_seed = False
        for row in range(offsets[i], offsets[i + 1]):
            with_seed |= landmarks[row] == seed
        if with_seed:
            columns[j] = i
            j += 1
            for row in range(offsets[i], offsets[i + 1]):
                if slots[landmarks[row]] < 0 and landmarks[row] != seed:
                    slots[landmarks[row]] = 0
                    present[n] = landmarks[row]
                    n += 1
    members = np.empty(n + 1, np.int64)
    members[0] = seed
    members[1:] = np.sort(present[:n])
    for slot in range(n + 1):
        slots[members[slot]] = slot
    block = np.full((n + 1, j, points.shape[1]), np.nan)
    for column in range(j):
        i = columns[column]
        for row in range(offsets[i], offsets[i + 1]):
            for a in range(points.shape[1]):
                block[slots[landmarks[row]], column, a] = points[row, a]
    slots[members] = -1
    return members, columns[:j].copy(), block
