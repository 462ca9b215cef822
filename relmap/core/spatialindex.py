"""A grid of landmarks that grows with the map and is asked for what lies near."""

from __future__ import annotations

import itertools
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray


class SpatialIndex:
    """Landmarks by the cell of a grid that they lie in; the cost of asking is that of a few cells.

    Parameters
    ----------
    cell_m : float
        Side of a cell, metres: nothing farther than this is asked for.
    dimension : int
    """

    def __init__(self, cell_m: float, dimension: int) -> None:
        self.cell_m = cell_m
        self._cells: defaultdict[tuple[int, ...], list[int]] = defaultdict(list)
        self._around = np.array(list(itertools.product((-1, 0, 1), repeat=dimension)))

    def add(self, landmarks: NDArray[np.int64], positions: NDArray[np.float64]) -> None:
        """Enter landmarks (k,) at positions (k, d)."""
        for landmark, cell in zip(landmarks.tolist(), self._cell_of(positions), strict=True):
            self._cells[tuple(cell.tolist())].append(landmark)

    def near(self, position: NDArray[np.float64]) -> list[int]:
        """Return the landmarks within a cell's side of the position (d,), and some more."""
        cells = (self._cell_of(position[None])[0] + self._around).tolist()
        return [landmark for cell in cells for landmark in self._cells.get(tuple(cell), ())]

    def _cell_of(self, positions: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.floor(positions / self.cell_m).astype(np.int64)
