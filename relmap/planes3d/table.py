"""The public table of planes, with their outlines."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.shown import Table
from relmap.planes3d.gathering import is_rough
from relmap.planes3d.outlines import surfaces_of
from relmap.planes3d.refining import covariances_of, scene
from relmap.planes3d.sights import is_dynamic, is_edge_on
from relmap.planes3d.submap import Submap

RAGGED = "outline", "meets"
"""Columns whose length differs from plane to plane."""
FARTHEST_RAD = 1.0
"""Standard deviation of a normal above which it is unknown."""
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
    sd_normal, sd_centre : (n,) float64, radians and metres
        Standard deviations of the normal, in its least certain direction, and of the position at
        the centre, along the normal. They describe the error in the frame of the submap, after
        `refine` and until the next scan; NaN otherwise, and where the observations do not determine
        the plane to within the size of the submap.
    area_m2 : (n,) float64
        Area of the squares in which it was seen: of the size of a voxel, smaller on narrow planes.
    outline : list of (k, 3) float64, frame of the submap, metres
        Of the largest part of its surface, anticlockwise as seen from its front.
    meets : list of (k,) int64
        Number of the plane that meets it between this corner of the outline and the next. If none
        does, -2 if the surface ends there, as scans saw past it, or -1 if nothing was seen beyond,
        or the plane was only found by `refine`.
    observations, first_iteration, last_iteration : (n,) int64
        Number of scans that saw it, the first and the last; those included in which only `refine`
        found it, and which have no label from `update`.
    status : (n,) str
        After `finish` or `refine`: "dynamic" if scans often saw through it; "static" if not, and if
        it is in the first submap, at least two scans saw it and it is not much thicker than the
        noise; else "unmapped".
    submap : (n,) int64
        Rank of the submap, the largest first.
    covariance : (n, 4, 4) float64
        Of `normal` and `offset`, NaN as `sd_normal`; no rows in a table read from files.
    """

    plane: Ints
    normal: Floats
    offset: Floats
    centre: Floats
    sd: Floats
    sd_normal: Floats
    sd_centre: Floats
    area_m2: Floats
    outline: list[Floats]
    meets: list[Ints]
    observations: Ints
    first_iteration: Ints
    last_iteration: Ints
    status: NDArray[np.str_]
    submap: Ints
    covariance: Floats = field(default_factory=lambda: np.empty((0, 4, 4)))


def plane_table(submaps: list[Submap], is_refined: bool) -> Plane3dTable:
    """Return the table of the planes of all submaps; `is_refined`: after the last scan."""
    parts = [_rows(part, rank, is_refined) for rank, part in enumerate(submaps)]
    if not parts:
        none, number = np.empty((0, 3)), np.empty(0, dtype=np.int64)
        flat, status = np.empty(0), np.empty(0, dtype=np.str_)
        given = none, flat, none, flat, flat, flat, flat
        return Plane3dTable(number, *given, [], [], number, number, number, status, number)
    columns: dict[str, Any] = {}
    for name in parts[0]:
        values = [part[name] for part in parts]
        columns[name] = [*chain(*values)] if name in RAGGED else np.concatenate(values)
    return Plane3dTable(**columns)


def is_mapped(part: Submap) -> Bools:
    """Return which landmarks (l,) of a submap are planes, seen in two scans, that stay in place."""
    is_plane = ~is_rough(part) & ~is_edge_on(part)
    return np.asarray((part.n_scans >= FEWEST) & is_plane & ~is_dynamic(part))


def _rows(part: Submap, rank: int, is_refined: bool) -> dict[str, Any]:
    order = np.argsort(part.number, kind="stable")
    planes = part.all_planes()
    mapped = is_mapped(part)
    surfaces = surfaces_of(planes, np.flatnonzero(mapped))
    outlines = [surfaces[k].outline() for k in order.tolist()]
    rasters = [surfaces[k].raster for k in order.tolist()]
    static = mapped & (rank == 0)
    status = np.where(is_dynamic(part), "dynamic", np.where(static, "static", "unmapped"))
    return {
        "plane": part.number[order],
        "normal": planes.normal[order],
        "offset": planes.offset[order],
        "centre": planes.centre[order],
        "sd": planes.spread[order, 2],
        "area_m2": np.array([each.filled.sum() * each.size_m**2 for each in rasters]),
        "outline": [outline for outline, _ in outlines],
        # Negative values, of pieces that meet no plane, may be beyond the number of planes.
        "meets": [
            np.where(meets >= 0, part.number[np.maximum(meets, 0)], meets) for _, meets in outlines
        ],
        "observations": part.n_scans[order],
        "first_iteration": np.array(part.iteration)[part.spans[0][order]],
        "last_iteration": part.last[order],
        "status": status[order],
        "submap": np.full(len(part), rank),
        **{name: values[order] for name, values in _uncertainty(part, is_refined).items()},
    }


def _uncertainty(part: Submap, is_refined: bool) -> dict[str, Floats]:
    """Return the covariances of planes and what follows from them; NaN where unknown."""
    found = {
        "covariance": np.full((len(part), 4, 4), np.nan),
        "sd_normal": np.full(len(part), np.nan),
        "sd_centre": np.full(len(part), np.nan),
    }
    if is_refined:
        covariance, state = covariances_of(part), scene(part)
        lever = np.insert(-state.base, 3, 1.0, axis=1)
        sd_m = np.sqrt(np.einsum("ni,nij,nj->n", lever, covariance, lever))
        sd_rad = np.sqrt(np.linalg.eigvalsh(covariance[:, :3, :3])[:, 2])
        known = sd_m < np.ptp(np.concatenate([state.t, state.base]), axis=0).max()
        known &= sd_rad < FARTHEST_RAD
        for values, all_values in zip(found.values(), (covariance, sd_rad, sd_m), strict=True):
            values[known] = all_values[known]
    return found
