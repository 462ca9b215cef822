"""The public table of planes, with their outlines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.columns import Table
from relmap.planes3d.outlines import surfaces_of
from relmap.planes3d.roughness import is_rough
from relmap.planes3d.submap import Submap

RAGGED = "outline", "meets"
"""Columns whose length differs from plane to plane."""
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
        Area of the squares in which it was seen: of the size of a voxel, smaller on narrow planes.
    outline : list of (k, 3) float64, frame of the submap, metres
        Of the largest part of its surface, anticlockwise as seen from its front.
    meets : list of (k,) int64
        Number of the plane that meets it between this corner of the outline and the next. If none
        does, -2 if the surface ends there, as scans saw past it, or -1 if nothing was seen beyond,
        or the plane was only found by `refine`.
    observations, first_iteration, last_iteration : (n,) int64
        Number of scans that saw it, the first and the last.
    status : (n,) str
        "dynamic" if later scans mostly saw through it; "static" if not, and if it is in the first
        submap, at least two scans saw it and it is not much thicker than the noise; else
        "unmapped".
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
    meets: list[Ints]
    observations: Ints
    first_iteration: Ints
    last_iteration: Ints
    status: NDArray[np.str_]
    submap: Ints


def plane_table(submaps: list[Submap]) -> Plane3dTable:
    """Return the table of the planes of all submaps."""
    parts = [_rows(part, rank) for rank, part in enumerate(submaps)]
    if not parts:
        none, number = np.empty((0, 3)), np.empty(0, dtype=np.int64)
        flat, status = np.empty(0), np.empty(0, dtype=np.str_)
        return Plane3dTable(
            number, none, flat, none, flat, flat, [], [], number, number, number, status, number
        )
    columns = {name: [part[name] for part in parts] for name in parts[0]}
    whole: dict[str, Any] = {
        name: [each for part in columns.pop(name) for each in part] for name in RAGGED
    }
    whole |= {name: np.concatenate(values) for name, values in columns.items()}
    return Plane3dTable(**whole)


def _rows(part: Submap, rank: int) -> dict[str, Any]:
    order = np.argsort(part.number, kind="stable")
    planes = part.all_planes()
    when = np.repeat(part.iteration, [len(match) for match in part.match])
    landmark, scan = np.unique(np.column_stack([np.concatenate(part.match), when]), axis=0).T
    sights = np.bincount(landmark, minlength=len(part))
    first = np.full(len(part), np.iinfo(np.int64).max)
    np.minimum.at(first, landmark, scan)
    mapped = (sights >= FEWEST) & ~is_rough(part)
    surfaces = surfaces_of(planes, np.flatnonzero(mapped & ~part.is_dynamic))
    outlines = [surfaces[k].outline() for k in order.tolist()]
    rasters = [surfaces[k].raster for k in order.tolist()]
    static = mapped & (rank == 0)
    status = np.where(part.is_dynamic, "dynamic", np.where(static, "static", "unmapped"))
    return {
        "plane": part.number[order],
        "normal": planes.normal[order],
        "offset": planes.offset[order],
        "centre": planes.centre[order],
        "sd": planes.spread[order, 2],
        "area_m2": np.array([each.filled.sum() * each.size_m**2 for each in rasters]),
        "outline": [outline for outline, _ in outlines],
        "meets": [np.where(meets >= 0, part.number[meets], meets) for _, meets in outlines],
        "observations": sights[order],
        "first_iteration": first[order],
        "last_iteration": part.last[order],
        "status": status[order],
        "submap": np.full(len(part), rank),
    }
