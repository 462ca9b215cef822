"""Refining the whole map: each submap by itself, by least squares or by what its noise allows."""

from __future__ import annotations

import logging

import numpy as np

from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined, refine
from relmap.core.refinement.observations import observations_of
from relmap.core.refinement.powers import refine_by_powers
from relmap.core.state.store import ObservationStore
from relmap.core.state.table import NONE

logger = logging.getLogger(__name__)


def refine_submaps(
    global_map: GlobalMap, rows: SegmentRows, kept: ObservationStore | None
) -> list[Refined]:
    """Move all landmarks to where the observations agree best; tell of each submap, in order.

    Parameters
    ----------
    global_map : GlobalMap
    rows : SegmentRows
    kept : ObservationStore, optional
        Every observation, where bounded noise is to be made use of.
    """
    table = global_map.table
    of, submaps, moving = table.landmark_of, table.submap, table.dynamic
    others = (submaps == NONE) & ~moving
    found = []
    for submap in np.unique(submaps[submaps != NONE]):
        refined = refine(rows, table.position, submaps == submap, of, others, moving)
        if refined is not None and kept is not None:
            seen = observations_of(kept, refined.landmarks, refined.positions, of)
            refined = refine_by_powers(refined, seen)
        if refined is not None:
            global_map.move(refined.landmarks, refined.positions)
            found.append(refined)
            if not refined.converged:
                logger.warning(
                    "refinement of %d landmarks did not converge: the map is the best that was "
                    "found, and what its sd says may be wrong",
                    len(refined.landmarks),
                )
    return found
