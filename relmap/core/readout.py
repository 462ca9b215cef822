"""From the state of a mapper to what it hands out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.building import MapBuilder
from relmap.core.globalmap import UNMAPPED, GlobalMap
from relmap.core.landmarks import LandmarkTable, Piece, in_space
from relmap.core.sightings import Sightings


def positions_in_largest_piece(global_map: GlobalMap) -> NDArray[np.float64]:
    """Return the positions (n, d) of the largest piece, map frame, metres; NaN for the others."""
    return np.where(_ranks(global_map)[:, None] == 0, global_map.positions, np.nan)


def landmark_table(
    sightings: Sightings,
    builder: MapBuilder,
    labels: NDArray[np.int64],
    own: NDArray[np.bool_],
) -> LandmarkTable:
    """Return the table of all landmarks, in ascending order of their labels (n,).

    Those not their own any longer, merged into another, are left out.
    """
    order = np.argsort(labels)
    order = order[own[order]]
    global_map, noise_m = builder.map, builder.noise.sigma_m
    rank = _ranks(global_map)
    mapped = rank == 0
    status = np.where(mapped, "static", np.where(builder.dynamics.dynamic, "dynamic", "unmapped"))
    averaged = np.where(mapped, np.maximum(global_map.weights, 1), 1)
    return LandmarkTable(
        landmark=labels[order],
        position=in_space(positions_in_largest_piece(global_map))[order],
        sd=np.where(mapped, noise_m / np.sqrt(averaged), np.nan)[order],
        observations=sightings.counts[order],
        first_iteration=sightings.first[order],
        last_iteration=sightings.last[order],
        level=np.where(mapped, builder.levels.highest, 0)[order],
        status=status[order],
        piece=rank[order],
    )


def map_pieces(
    sightings: Sightings, global_map: GlobalMap, labels: NDArray[np.int64]
) -> list[Piece]:
    """Return the pieces of the map, the largest first."""
    rank = _ranks(global_map)
    pieces = []
    for piece in range(int(rank.max(initial=UNMAPPED)) + 1):
        members = np.flatnonzero(rank == piece)
        members = members[np.argsort(labels[members])]
        positions = in_space(global_map.positions[members])
        seen = int(sightings.first[members].min()), int(sightings.last[members].max())
        pieces.append(Piece(labels[members], positions, *seen))
    return pieces


def _ranks(global_map: GlobalMap) -> NDArray[np.int64]:
    """Return the place of each landmark's piece in the order of their sizes, or `UNMAPPED`."""
    mapped = global_map.pieces != UNMAPPED
    pieces, members, counts = np.unique(
        global_map.pieces[mapped], return_inverse=True, return_counts=True
    )
    rank_of = np.empty(len(pieces), dtype=np.int64)
    rank_of[np.argsort(-counts, kind="stable")] = np.arange(len(pieces))
    ranks = np.full(len(mapped), UNMAPPED)
    ranks[mapped] = rank_of[members]
    return ranks
