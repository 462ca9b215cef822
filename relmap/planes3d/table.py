"""The public table of planes, with their outlines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.columns import Table
from relmap.planes3d.submap import Submap
from relmap.segmentation.space import Patches

FEWEST = 2
"""Minimum number of scans that saw a mapped plane."""


@dataclass(frozen=True, eq=False, repr=False)
class Plane3dTable(Table):
    """All planes, one row each, by submap and number.

    Attributes
    ----------
    plane : (n,) int64
        Landmark number.
    normal : (n, 3) float64, frame of the submap
        Unit normals that point to the side from which the plane was seen.
    offset : (n,) float64, metres
        ``normal @ x == offset`` on the plane.
    centre : (n, 3) float64, frame of the submap, metres
        Weighted mean of its points.
    sd : (n,) float64, metres
        Standard deviation of its points across it.
    area_m2 : (n,) float64
        Area of the squares, of the size of a voxel, in which it was seen.
    outline : list of (k, 3) float64, frame of the submap, metres
        Of the largest part of its surface, anticlockwise as seen from its front.
    observations, first_iteration, last_iteration : (n,) int64
        Number of scans that saw it, the first and the last.
    status : (n,) str
        "dynamic" if later scans mostly saw through it; "static" if not, and if it is in the first
        submap and at least two scans saw it; else "unmapped".
    submap : (n,) int64
        Rank of the submap, the largest first.
    """

    plane: Ints
    normal: Floats
    offset: Floats
    centre: Floats
    sd: Floats
    area_m2: Floats
    outline: list[Floats]
    observations: Ints
    first_iteration: Ints
    last_iteration: Ints
    status: NDArray[np.str_]
    submap: Ints


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


def plane_table(submaps: list[Submap]) -> Plane3dTable:
    """Return the table of the planes of all submaps."""
    parts = [_rows(part, rank) for rank, part in enumerate(submaps)]
    if not parts:
        none, number = np.empty((0, 3)), np.empty(0, dtype=np.int64)
        flat, status = np.empty(0), np.empty(0, dtype=np.str_)
        return Plane3dTable(
            number, none, flat, none, flat, flat, [], number, number, number, status, number
        )
    columns = {name: [part[name] for part in parts] for name in parts[0]}
    outline = [each for part in columns.pop("outline") for each in part]
    whole: dict[str, Any] = {name: np.concatenate(values) for name, values in columns.items()}
    return Plane3dTable(outline=outline, **whole)


def _rows(part: Submap, rank: int) -> dict[str, Any]:
    order = np.argsort(part.number, kind="stable")
    planes = part.all_planes()
    rasters = [raster(planes, k) for k in order.tolist()]
    when = np.repeat(part.iteration, [len(match) for match in part.match])
    landmark, scan = np.unique(np.column_stack([np.concatenate(part.match), when]), axis=0).T
    sights = np.bincount(landmark, minlength=len(part))
    first = np.full(len(part), np.iinfo(np.int64).max)
    np.minimum.at(first, landmark, scan)
    static = (sights >= FEWEST) & (rank == 0)
    status = np.where(part.is_dynamic, "dynamic", np.where(static, "static", "unmapped"))
    return {
        "plane": part.number[order],
        "normal": planes.normal[order],
        "offset": planes.offset[order],
        "centre": planes.centre[order],
        "sd": planes.spread[order, 2],
        "area_m2": np.array([each.filled.sum() * each.size_m**2 for each in rasters]),
        "outline": [outline(each) for each in rasters],
        "observations": sights[order],
        "first_iteration": first[order],
        "last_iteration": part.last[order],
        "status": status[order],
        "submap": np.full(len(part), rank),
    }


def raster(planes: Patches, k: int) -> Raster:
    """Return the grid of a plane, with gaps of one square closed."""
    from scipy.ndimage import binary_closing

    u, v, _ = planes.axes[k]
    size_m, base = planes.cell_m, planes.centre[k]
    cells = (planes.cells[planes.cell_patch == k] - base) @ np.stack([u, v]).T
    if not len(cells):
        cells = np.zeros((1, 2))
    origin = cells.min(axis=0) - 2.5 * size_m
    at = np.floor((cells - origin) / size_m).astype(np.int64)
    filled = np.zeros(at.max(axis=0) + 3, dtype=bool)
    filled[tuple(at.T)] = True
    return Raster(
        binary_closing(filled, np.ones((3, 3), dtype=np.bool_)), origin, size_m, base, u, v
    )


def outline(surface: Raster) -> Floats:
    """Return the outline (k, 3) of the largest connected part of a surface, anticlockwise."""
    from contourpy import contour_generator  # comes with matplotlib, as Pillow does
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(surface.filled.astype(np.float64), 0.6)
    lines = contour_generator(z=smooth.T).lines(0.4)
    areas = [_area(np.asarray(line)) for line in lines]
    if not areas:
        return np.empty((0, 3))
    largest = int(np.argmax(np.abs(areas)))
    line = np.asarray(lines[largest])[:-1]
    return surface.in_space((line if areas[largest] > 0 else line[::-1]) + 0.5)


def _area(line: Floats) -> float:
    """Return the area enclosed by a closed line (k, 2), positive if anticlockwise."""
    x, y = line.T
    return float(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2
