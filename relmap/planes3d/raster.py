"""The surface of a plane as a grid of squares in which it was seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats
from relmap.segmentation.space import Patches

NARROW = 4
"""Number of squares across a narrow plane, if its cells are close enough."""
BESIDE, MOST = 4, 0.9
"""Its squares are at least as large as the distance of most cells (the fraction) from so many."""


@dataclass(frozen=True, eq=False)
class Raster:
    """The surface of a plane as a grid of squares.

    `filled` (a, b): squares in which the plane was seen; `origin` (2,), metres: corner of the first
    square, along `u` and `v` from `base`; `size_m`: side of a square; `base`, `u`, `v` (3,): a
    point on the plane, and unit vectors along it.
    """

    filled: Bools
    origin: Floats
    size_m: float
    base: Floats
    u: Floats
    v: Floats

    def in_space(self, points: Floats) -> Floats:
        """Convert points (n, 2), in squares from the origin, to points in space (n, 3)."""
        at = self.origin + self.size_m * points
        return np.asarray(self.base + at[:, :1] * self.u + at[:, 1:] * self.v)

    def in_squares(self, points: Floats) -> Floats:
        """Convert points in space (n, 3) to points (n, 2), in squares from the origin."""
        flat = (points - self.base) @ np.stack([self.u, self.v]).T
        return np.asarray((flat - self.origin) / self.size_m)


def raster(planes: Patches, k: int) -> Raster:
    """Return the grid of a plane, with gaps of one square closed."""
    from scipy.ndimage import binary_closing

    u, v, _ = planes.axes[k]
    base = planes.centre[k]
    cells = (planes.cells[planes.cell_patch == k] - base) @ np.stack([u, v]).T
    if not len(cells):
        cells = np.zeros((1, 2))
    size_m = _side(cells, planes.cell_m, np.sqrt(12) * planes.spread[k, 1])
    origin = cells.min(axis=0) - 2.5 * size_m
    at = np.floor((cells - origin) / size_m).astype(np.int64)
    filled = np.zeros(at.max(axis=0) + 3, dtype=bool)
    filled[tuple(at.T)] = True
    closed = binary_closing(filled, np.ones((3, 3), dtype=np.bool_))
    return Raster(closed, origin, size_m, base, u, v)


def _side(cells: Floats, cell_m: float, width_m: float) -> float:
    """Return the side of the squares of a plane of this width with cells (n, 2)."""
    if width_m > NARROW * cell_m or len(cells) <= BESIDE:
        return cell_m
    away = np.asarray(cKDTree(cells).query(cells, BESIDE + 1)[0])
    return float(min(cell_m, max(np.quantile(away[:, BESIDE], MOST), width_m / NARROW)))
