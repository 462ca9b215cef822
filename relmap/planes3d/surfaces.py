"""Surfaces of the map: where planes were seen, and what lies near them."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.segmentation.space import Patches

LOOKED_AT = 16
"""Number of cells of each plane by which it is looked for elsewhere."""
NEAR = 3.0
"""Largest distance, in cells, of cells of overlapping surfaces."""
SIDE = np.cos(np.deg2rad(12.0))
"""Tolerance of the normals of one plane (cosine)."""


def some_cells(planes: Patches) -> Ints:
    """Return some cells (k,) of each plane, evenly chosen."""
    of, count = planes.cell_patch, np.bincount(planes.cell_patch, minlength=len(planes))
    rank = np.arange(len(of)) - (np.cumsum(count) - count)[of]
    return np.flatnonzero(rank * LOOKED_AT % count[of] < LOOKED_AT)


class Surfaces:
    """Planes of the map with a grid of the cells where they were seen.

    `planes`: in the frame of the map. `side_m`: of the cubes of the grid, metres; twice the longest
    search is fastest. By default the longest one of a placement.
    """

    def __init__(self, planes: Patches, side_m: float | None = None) -> None:
        from relmap.core.geometry.spatialindex_kernels import link
        from relmap.planes3d.nearest_kernels import keys_of

        self.planes = planes
        side_m = side_m or 2 * NEAR * planes.cell_m
        keys = keys_of(np.ascontiguousarray(planes.cells), side_m)
        order = np.argsort(keys, kind="stable")
        key, begin = np.unique(keys[order], return_index=True)
        first = np.full(1 << (2 * len(key) + 1).bit_length(), -1)
        following = np.full(len(key), -1)
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
