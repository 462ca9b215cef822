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
        self._members: defaultdict[tuple[int, ...], list[int]] = defaultdict(list)
        self._cell: dict[int, tuple[int, ...]] = {}
        self._around = np.array(list(itertools.product((-1, 0, 1), repeat=dimension)))

    def add(self, landmarks: NDArray[np.int64], positions: NDArray[np.float64]) -> None:
        """Enter landmarks (k,) at positions (k, d), in place of where they were before."""
        cells = map(tuple, self._cell_of(positions).tolist())
        for landmark, cell in zip(landmarks.tolist(), cells, strict=True):
            before = self._cell.get(landmark)
            if before != cell:
                if before is not None:
                    self._members[before].remove(landmark)
                self._members[cell].append(landmark)
                self._cell[landmark] = cell

    def near(self, position: NDArray[np.float64]) -> list[int]:
        """Return the landmarks within a cell's side of the position (d,), and some more."""
        cells = (self._cell_of(position[None])[0] + self._around).tolist()
        return [landmark for cell in cells for landmark in self._members.get(tuple(cell), ())]

    @property
    def landmarks(self) -> NDArray[np.int64]:
        """All landmarks entered; (n,)."""
        return np.array(list(self._cell), dtype=np.int64)

    def _cell_of(self, positions: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.floor(positions / self.cell_m).astype(np.int64)
