"""The static points that walls show, compiled; see `relmap.planes.model`."""

from __future__ import annotations

import math

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.linalg.compiling import compiled


@compiled
def corners_and_midpoints(
    landmark: Ints, corner: Ints, ends: Floats, half: Floats
) -> tuple[Ints, Floats, Ints]:
    """Return the corners of walls, and their estimated midpoints (Fig. 4).

    `landmark`, `corner` (n, 2): landmark and corner at either end of each wall; -1 for none. `ends`
    (n, 2, 2), robot frame, metres. `half` (c,), metres: half the fixed size of the wall of each
    corner. Returns `landmarks` (k,), `points_robot` (k, 2): corners and midpoints alternate and
    `per_row` (n,).
    """
    k, per_row = 0, np.zeros(len(landmark), dtype=np.int64)
    for i in range(len(landmark)):
        for e in range(2):
            if landmark[i, e] >= 0:
                per_row[i] += 2
        k += per_row[i]
    landmarks, points = np.empty(k, dtype=np.int64), np.empty((k, 2))
    k = 0
    for i in range(len(landmark)):
        x, y = ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1]
        size = math.hypot(x, y)
        for e in range(2):
            if landmark[i, e] < 0:
                continue
            inwards = half[corner[i, e]] if e == 0 else -half[corner[i, e]]
            landmarks[k], landmarks[k + 1] = landmark[i, e], 2 * corner[i, e] + 1
            points[k, 0], points[k, 1] = ends[i, e, 0], ends[i, e, 1]
            points[k + 1, 0] = ends[i, e, 0] + inwards * (x / size)
            points[k + 1, 1] = ends[i, e, 1] + inwards * (y / size)
            k += 2
    return landmarks, points, per_row
