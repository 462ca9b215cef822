"""From the state of a mapper to what it hands out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from relmap.core.building import MapBuilder
from relmap.core.dynamics import ALONE
from relmap.core.globalmap import UNMAPPED, GlobalMap
from relmap.core.landmarks import LandmarkMap, LandmarkTable, Piece, in_space
from relmap.core.refinement import Refined
from relmap.core.sightings import Sightings


def positions_in_largest_piece(global_map: GlobalMap) -> NDArray[np.float64]:
    """Return the positions (n, d) of the largest piece, map frame, metres; NaN for the others."""
    return np.where(_ranks(global_map)[:, None] == 0, global_map.positions, np.nan)


def covariances_in_largest_piece(
    builder: MapBuilder, refined: Sequence[Refined]
) -> NDArray[np.float64]:
    """Return how sure the positions are: covariances (n, d, d), square metres; NaN if not mapped.

    After refinement they are those of the joint least squares, in the frame of the robot in the
    piece's first iteration.  Before, only that of the average behind a position is known, which the
    drift of the chain comes on top of.
    """
    mapped = _ranks(builder.map) == 0
    d = builder.map.positions.shape[1]
    variance = builder.noise.sigma_m**2 / np.maximum(builder.map.weights, 1)
    covariances: NDArray[np.float64] = variance[:, None, None] * np.eye(d)
    for piece in refined:
        if mapped[piece.landmarks].any():
            covariances[piece.landmarks] = piece.covariances
    covariances[~mapped] = np.nan
    return covariances


def landmark_map(
    builder: MapBuilder,
    refined: Sequence[Refined],
    labels: NDArray[np.int64],
) -> LandmarkMap:
    """Return the largest piece, in ascending order of its landmarks' labels."""
    members = np.flatnonzero(_ranks(builder.map) == 0)
    members = members[np.argsort(labels[members])]
    covariances = np.zeros((len(members), 3, 3))
    d = builder.map.positions.shape[1]
    covariances[:, :d, :d] = covariances_in_largest_piece(builder, refined)[members]
    return LandmarkMap(labels[members], in_space(builder.map.positions[members]), covariances)


def landmark_table(
    sightings: Sightings,
    builder: MapBuilder,
    refined: Sequence[Refined],
    labels: NDArray[np.int64],
    own: NDArray[np.bool_],
) -> LandmarkTable:
    """Return the table of all landmarks, in ascending order of their labels (n,).

    Those not their own any longer, merged into another, are left out.
    """
    order = np.argsort(labels)
    order = order[own[order]]
    rank = _ranks(builder.map)
    mapped = rank == 0
    status = np.where(mapped, "static", np.where(builder.dynamics.dynamic, "dynamic", "unmapped"))
    covariances = covariances_in_largest_piece(builder, refined)
    variance = np.trace(covariances, axis1=1, axis2=2) / max(covariances.shape[1], 1)
    return LandmarkTable(
        landmark=labels[order],
        position=in_space(positions_in_largest_piece(builder.map))[order],
        sd=np.sqrt(variance)[order],
        observations=sightings.counts[order],
        first_iteration=sightings.first[order],
        last_iteration=sightings.last[order],
        level=np.where(mapped, builder.levels.highest, 0)[order],
        status=status[order],
        piece=rank[order],
        moving_bin=_moving_bins(builder, status, labels)[order],
    )


def _moving_bins(
    builder: MapBuilder, status: NDArray[np.str_], labels: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return which dynamic landmarks go together: the label (n,) of one of them, or `ALONE`."""
    bins = np.where(status == "dynamic", builder.dynamics.moving_bin, ALONE)
    _, first, members, sizes = np.unique(
        bins, return_index=True, return_inverse=True, return_counts=True
    )
    together = (bins != ALONE) & (sizes[members] > 1)
    return np.where(together, labels[first[members]], ALONE)


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
