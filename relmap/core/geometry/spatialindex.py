"""A grid of landmarks for neighbour queries that grows with the map."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.state.table import NONE, LandmarkState

BUCKETS = 2**12
"""Initial number of buckets, a power of two."""


class SpatialIndex:
    """Landmarks by grid cell; a query costs as much as a few cells.

    The cells are hashed into buckets, whose landmarks are linked lists in plain arrays.

    `table`: its columns `cell` and `next_in_cell` are the key of the cell of each landmark and the
    next landmark in the bucket; `cell_m`: side of a cell, metres: the largest query radius.
    """

    STATE = "cell_m"

    def __init__(self, table: LandmarkState, cell_m: float) -> None:
        self.cell_m = cell_m
        self._table = table
        self._first = np.full(BUCKETS, NONE, np.int32)
        self._n = 0

    def restored(self) -> None:
        """Link the landmarks of the restored table."""
        self._link(BUCKETS)

    def add(self, landmarks: Ints) -> None:
        """Insert the mapped ones of landmarks (k,), replacing earlier positions."""
        import relmap.core.geometry.spatialindex_kernels as kernels

        of = self._table
        columns = of.next_in_cell, of.cell, of.position, of.weight
        self._n += kernels.enter(self._first, columns, landmarks, self.cell_m)
        if self._n > len(self._first):
            self._link(len(self._first))

    def near(self, positions: Floats, before: Ints) -> tuple[Ints, Ints]:
        """Return pairs of a row of the positions (k, d) and a landmark, in the order of the rows.

        All landmarks within a cell's side of a position that were last seen `before` (k,) an
        iteration are included, and some others.
        """
        import relmap.core.geometry.spatialindex_kernels as kernels

        of = self._table
        grid = self._first, of.next_in_cell, of.cell, of.last
        return kernels.near(grid, positions, self.cell_m, before)

    def _link(self, n_buckets: int) -> None:
        """Link all landmarks anew, with four times as many buckets as landmarks or more."""
        import relmap.core.geometry.spatialindex_kernels as kernels

        n = int(np.sum(self._table.cell != NONE))
        while n_buckets < 4 * n:
            n_buckets *= 2
        self._first = np.full(n_buckets, NONE, np.int32)
        self._n = kernels.link(self._first, self._table.next_in_cell, self._table.cell)
