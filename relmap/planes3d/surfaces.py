"""Surfaces of the map: where planes were seen, and what lies near them."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.planes3d.hypotheses import Motions
from relmap.segmentation.space import Patches

LOOKED_AT = 16
"""Number of cells of each plane of a scan from which overlapping planes are found."""
NEAR = 3.0
"""Largest distance, in cells, of cells of overlapping surfaces."""
SIDE = np.cos(np.deg2rad(12.0))
"""Tolerance of the normals of one plane (cosine)."""


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
        of, count = seen.cell_patch, np.bincount(seen.cell_patch, minlength=len(seen))
        rank = np.arange(len(of)) - (np.cumsum(count) - count)[of]
        rows = np.flatnonzero(rank * LOOKED_AT % count[of] < LOOKED_AT)
        reach_m = 2 * NEAR * max(self.planes.cell_m, seen.cell_m)
        mark_near(self._grid, self._plane, R, t, seen.cells[rows], of[rows], reach_m, near)
        return near

    def shares(
        self,
        motions: Motions,
        seen: Patches,
        cells: Floats,
        of: Ints,
        weight: Floats,
        hopeless: float,
        most: int,
    ) -> Floats:
        """Return the weight (h,) of cells of a scan near surfaces that face the same way.

        `seen`: planes of the scan, robot frame; `cells` (s, 3), `of` (s,), `weight` (s,): cells of
        the scan, and their planes; `hopeless`, `most`: motions below this fraction of the largest
        weight, or not among so many of the largest, may be given less.
        """
        from relmap.planes3d.nearest_kernels import shares

        facing = self.planes.normal[self._plane[:-1]]
        reach_m = NEAR * max(self.planes.cell_m, seen.cell_m)
        scan = motions.R, motions.t, cells, seen.normal[of], weight
        return shares(self._grid, facing, *scan, reach_m, hopeless, most)

    def near(self, points: Floats, reach_m: float) -> Ints:
        """Return the plane (n,) of the cell nearest to each point (n, 3); -1 out of reach."""
        return self.nearest(points, reach_m, 1)[:, 0]
