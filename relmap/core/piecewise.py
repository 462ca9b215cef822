"""Refining the whole map: each piece by itself, by least squares or by what its noise allows."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from relmap.core.condensing import SegmentRows
from relmap.core.globalmap import UNMAPPED, GlobalMap
from relmap.core.observations import KeptObservations
from relmap.core.powers import refine_by_powers
from relmap.core.refinement import Refined, refine

logger = logging.getLogger(__name__)


def refine_pieces(
    global_map: GlobalMap,
    rows: SegmentRows,
    of: NDArray[np.int64],
    moving: NDArray[np.bool_],
    kept: KeptObservations | None,
) -> list[Refined]:
    """Move all landmarks to where the observations agree best; tell of each piece, in order.

    Parameters
    ----------
    global_map : GlobalMap
    rows : SegmentRows
    of : (m,) int64
        The landmark that each number stands for, after merging.
    moving : (m,) bool
    kept : KeptObservations, optional
        Every observation, where bounded noise is to be made use of.
    """
    positions, pieces = global_map.positions, global_map.pieces
    others = (pieces == UNMAPPED) & ~moving
    found = []
    for piece in np.unique(pieces[pieces != UNMAPPED]):
        refined = refine(rows, positions, pieces == piece, of, others, moving)
        if refined is not None and kept is not None:
            seen = kept.of_landmarks(refined.landmarks, refined.positions, of)
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
