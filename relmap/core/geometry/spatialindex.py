"""A grid of landmarks for neighbour queries that grows with the map."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.state.table import NONE, LandmarkState

SIDE = 2**20
"""Cells along each axis with keys of their own; more distant cells only share a list."""
FARTHEST = 2.0**62
"""Largest index of a cell."""


class SpatialIndex:
    """Landmarks by grid cell; a query costs as much as a few cells.

    The landmarks of a cell are a linked list in plain arrays: millions of small objects would cause
    pauses by Python's garbage collector.

    Parameters
    ----------
    table : LandmarkState
        Its columns `cell` and `next_in_cell` are the lists.
    cell_m : float
        Side of a cell, metres: the largest query radius.
    """

    _first: dict[int, int]
    STATE = "cell_m _first"

    def __init__(self, table: LandmarkState, cell_m: float) -> None:
        dimension = table.dimension
        self.cell_m = cell_m
        self._table = table
        self._first = {}
        self._strides = SIDE ** np.arange(dimension)
        self._around = np.indices((3,) * dimension).reshape(dimension, -1).T - 1

    def add(self, landmarks: Ints, positions: Floats) -> None:
        """Enter landmarks (k,) at positions (k, d), replacing earlier positions."""
        keys = np.array(self._keys(self._cells(positions)), dtype=np.int64)
        before = self._table.cell[landmarks]
        for row in np.flatnonzero(keys != before).tolist():
            landmark, key = int(landmarks[row]), int(keys[row])
            if before[row] != NONE:
                self._remove(landmark, int(before[row]))
            self._table.next_in_cell[landmark] = self._first.get(key, NONE)
            self._first[key] = landmark
            self._table.cell[landmark] = key

    def near(self, positions: Floats) -> list[Ints]:
        """Return the landmarks within a cell's side of each position (k, d), and some others."""
        cells = self._cells(positions)[:, None] + self._around
        keys, n = self._keys(cells.reshape(-1, cells.shape[2])), len(self._around)
        each = []
        for k in range(0, len(keys), n):
            found = []
            for key in keys[k : k + n]:
                landmark = self._first.get(key, NONE)
                while landmark != NONE:
                    found.append(landmark)
                    landmark = int(self._table.next_in_cell[landmark])
            each.append(np.array(found, dtype=np.int64))
        return each

    def holds(self, landmarks: Ints) -> Bools:
        """Return which landmarks (k,) are in the index."""
        return np.asarray(self._table.cell[landmarks] != NONE)

    def _remove(self, landmark: int, key: int) -> None:
        after = int(self._table.next_in_cell[landmark])
        other = self._first[key]
        if other == landmark and after == NONE:
            del self._first[key]
        elif other == landmark:
            self._first[key] = after
        else:
            while self._table.next_in_cell[other] != landmark:
                other = int(self._table.next_in_cell[other])
            self._table.next_in_cell[other] = after

    def _cells(self, positions: Floats) -> Ints:
        with np.errstate(over="ignore"):  # far cells are one
            cells = np.floor(positions / self.cell_m)
        return np.clip(cells, -FARTHEST, FARTHEST).astype(np.int64)

    def _keys(self, cells: Ints) -> list[int]:
        """Return a non-negative key for each cell (k, d)."""
        keys: list[int] = (cells % SIDE @ self._strides).tolist()
        return keys
