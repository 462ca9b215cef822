"""Cells of a grid in which the planes of a submap, and their rims, were seen."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints

MIXED = -7046029254386353131
"""Multiplier that mixes the key of a cell with the number of a landmark (Fibonacci hashing)."""

Points = tuple[Floats, Ints, float]
"""Points (n, 3), submap frame, their landmarks (n,), or rims, and the size of cells, metres."""


class KnownCells:
    """The cells of each landmark that held a point so far."""

    def __init__(self) -> None:
        self._known: set[int] = set()
        self._latest = np.empty(0, dtype=np.int64)

    def fresh(self, scans: list[Points]) -> list[Ints]:
        """Return which points of each scan lie in cells of their landmark that had none yet."""
        from relmap.planes3d.nearest_kernels import keys_of

        each = [MIXED * keys_of(points, cell_m) + of for points, of, cell_m in scans]
        keys = np.concatenate(each)
        rows = np.sort(np.unique(keys, return_index=True)[1])
        # To fill a set takes longer than the rest, and refinement adds no more scans.
        self._known.update(self._latest.tolist())
        if self._known:
            rows = rows[[key not in self._known for key in keys[rows].tolist()]]
        self._latest = keys[rows]
        begin = np.cumsum([0, *(len(points) for points, *_ in scans)])
        parts = np.split(rows, np.searchsorted(rows, begin[1:-1]))
        return [part - first for part, first in zip(parts, begin.tolist(), strict=False)]
