"""Submaps of walls as `refine` makes them: each refined by itself, then drawn as a floor plan."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relmap.planes.assembly import WallNumbers
from relmap.planes.beams import BeamStore
from relmap.planes.floor_plan import floor_plan
from relmap.planes.grouped_map import GroupedMap
from relmap.planes.refined_map import refined_map
from relmap.planes.submaps import WallSubmap


class RefinedWalls(NamedTuple):
    """Submaps, their association, and the plane tracks (k,) that are not where they have them."""

    submaps: list[WallSubmap]
    numbers: WallNumbers
    moved: NDArray[np.int64]


def refined_submaps(
    grouped: GroupedMap, moving: NDArray[np.bool_], beams: BeamStore
) -> RefinedWalls:
    """Refine each submap by itself, from where the groups place the scans.

    The association is found anew, where walls come to lie: merged by places that have drifted, some
    are wrong.  A submap that cannot be refined stays as chained.

    Parameters
    ----------
    grouped : GroupedMap
    moving : (p,) bool
        Plane tracks that say nothing, for they move.
    beams : BeamStore
        What is seen through is no wall.
    """
    history, numbers = grouped.history, grouped.at_rest(grouped.unmerged)
    merged, moved = grouped.at_rest(grouped.numbers), [np.empty(0, dtype=np.int64)]
    submaps = grouped.submaps(merged, moving)
    for k, submap in enumerate(grouped.submaps(numbers, moving)):
        found = refined_map(history, numbers, submap, moving)
        if found is None:
            numbers = grouped.with_those_of(submap.span, numbers, merged)
        else:
            submaps[k], numbers = found
    for k, submap in enumerate(submaps):
        submaps[k], numbers, gone = floor_plan(submap, numbers, history, beams, moving)
        moved.append(gone)
    return RefinedWalls(submaps, numbers, np.concatenate(moved))
