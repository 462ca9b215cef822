"""Refinement of the whole map, one submap at a time."""

from __future__ import annotations

import numpy as np

from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined, refine
from relmap.core.refinement.observations import observations_of
from relmap.core.refinement.powers import refine_by_powers
from relmap.core.refinement.weighed import refine_weighed
from relmap.core.state.store import ObservationStore
from relmap.core.state.table import NONE
from relmap.core.state.weighed import WeighedObservations


def refine_submaps(
    global_map: GlobalMap,
    rows: SegmentRows,
    kept: ObservationStore | None,
    weighed: WeighedObservations,
) -> list[Refined]:
    """Move all landmarks to the joint optimum; return the refined submaps, in order.

    Parameters
    ----------
    global_map : GlobalMap
    rows : SegmentRows
    kept : ObservationStore, optional
        Every observation, to exploit bounded noise.
    weighed : WeighedObservations
        Observations with covariances; bounded noise is then not exploited.
    """
    table = global_map.table
    of, submaps = table.landmark_of, table.submap
    others = (submaps == NONE) & ~table.dynamic
    found, end = [], 0 if kept is None else kept.n_iterations
    for submap in np.unique(submaps[submaps != NONE]):
        refined = refine(rows, table.position, submaps == submap, of, others)
        if refined is not None and len(weighed):
            refined = refine_weighed(refined, weighed, of)
        elif refined is not None and kept is not None:
            points, (seen, when) = kept.points(0, end), kept.seen(0, end)
            own = refined.landmarks, refined.positions
            refined = refine_by_powers(refined, observations_of(points, of[seen], when, *own)[0])
        if refined is not None:
            global_map.move(refined.landmarks, refined.positions)
            found.append(refined)
    return found
