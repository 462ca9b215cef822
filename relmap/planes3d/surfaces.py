"""Surfaces of the map: where planes were seen, what lies near them, and as grids of squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.space import Patches

LOOKED_AT = 16
"""Number of cells of each plane by which it is looked for elsewhere."""
NEAR = 3.0
"""Largest distance, in cells, of cells of overlapping surfaces."""
SIDE = np.cos(np.deg2rad(12.0))
"""Tolerance of the normals of one plane (cosine)."""
MIXED = -7046029254386353131
"""Multiplier that mixes the key of a cell with the number of a landmark (Fibonacci hashing)."""
Points = tuple[Floats, Ints, float]
"""Points (n, 3), submap frame, their landmarks (n,), or rims, and the size of cells, metres."""
NARROW = 4
"""Number of squares across a narrow plane, if its cells are close enough."""
BESIDE, MOST = 4, 0.9
"""Its squares are at least as large as the distance of most cells (the fraction) from so many."""


def some_cells(planes: Patches) -> Ints:
    """Return some cells (k,) of each plane, evenly chosen."""
    of, count = planes.cell_patch, np.bincount(planes.cell_patch, minlength=len(planes))
    rank = np.arange(len(of)) - (np.cumsum(count) - count)[of]
    return np.flatnonzero(rank * LOOKED_AT % count[of] < LOOKED_AT)


class Surfaces:
    """Planes of the map with a grid of the cells where they were seen.

    `planes`: in the frame of the map. `side_m`: of the cubes of the grid, metres; twice the longest
    search is fastest. By default the longest one among them.
    """

    def __init__(self, planes: Patches, side_m: float | None = None) -> None:
        from relmap.core.geometry.spatialindex_kernels import link
        from relmap.planes3d.nearest_kernels import keys_of

        self.planes = planes
        side_m = side_m or 2 * NEAR * planes.cell_m
        keys = keys_of(np.ascontiguousarray(planes.cells), side_m)
        order = np.argsort(keys, kind="stable")
        key, begin = np.unique(keys[order], return_index=True)
        first = np.full(1 << (2 * len(key) + 1).bit_length(), -1, np.int32)
        following = np.full(len(key), -1, np.int32)
        link(first, following, key)
        begin = np.append(begin, len(order))
        self._grid = first, following, key, begin, planes.cells[order], side_m
        self._plane = np.append(planes.cell_patch[order], -1)

    def nearest(self, points: Floats, reach_m: float, count: int) -> Ints:
        """Return the planes (n, count) of the cells nearest to points (n, 3); -1 out of reach."""
        from relmap.planes3d.nearest_kernels import nearest

        cell = nearest(self._grid, np.ascontiguousarray(points), reach_m, count)
        return np.asarray(self._plane[cell])

    def overlapping(self, R: Floats, t: Floats, seen: Patches) -> Bools:
        """Return which planes of a scan were seen near which planes of the map: (m, k)."""
        from relmap.planes3d.nearest_kernels import mark_near

        near = np.zeros((len(seen), len(self.planes)), dtype=bool)
        rows, reach_m = some_cells(seen), 2 * NEAR * max(self.planes.cell_m, seen.cell_m)
        scan = seen.cells[rows], seen.cell_patch[rows]
        mark_near(self._grid, self._plane, R, t, *scan, reach_m, near)
        return near

    def shares(
        self, R: Floats, t: Floats, seen: Patches, cells: Floats, of: Ints, weight: Floats
    ) -> Floats:
        """Return the weight (h,) of cells of a scan near surfaces that face the same way.

        `R` (h, 3, 3), `t` (h, 3): poses; those that are hopeless may be given less. `seen`: planes
        of the scan, robot frame; `cells` (s, 3), `of` (s,), `weight` (s,): cells of the scan, and
        their planes.
        """
        from relmap.planes3d.nearest_kernels import shares

        facing = self.planes.normal[self._plane[:-1]]
        reach_m = NEAR * max(self.planes.cell_m, seen.cell_m)
        return shares(self._grid, facing, R, t, cells, seen.normal[of], weight, reach_m)


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
