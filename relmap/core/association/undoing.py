"""Undoing merges: of the tracks of a landmark, those that the refined map contradicts.

A landmark that is two things pulls the map to where it fits neither.  How far off a track of it is
left by the least squares over all observations is compared with what their noise, as it was
estimated there, explains.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined, laid_on
from relmap.core.state.table import NONE, LandmarkState

BY_CHANCE = 1e-3
"""How many right merges of a map may be taken for wrong."""
TORN = 3.0
"""How many times as far as usual a segment is off that was laid in a wrong place."""
SPREAD = 4.0
"""How many times as far off as usual a track must be, where noise does not explain what is usual.
"""
WORST = 0.5
"""Share of the worst deviation from which on others are undone with it: they may follow from it."""


def contradicted(
    refined: Refined, table: LandmarkState, rows: SegmentRows, usual: float = 1.0
) -> NDArray[np.int64]:
    """Return the merged tracks (k,) that a refined map contradicts.

    Those that are farther off their landmarks than noise explains, and those that began in
    segments that are: such a segment was laid in a wrong place.  The noise is that of the segment
    in the middle, for what is wrong raises that of the map.

    Parameters
    ----------
    refined : Refined
    table : LandmarkState
    rows : SegmentRows
        By tracks.
    usual : float
        Most that segments usually deviate from the map, in units of what noise explains.  Where
        odometry ties them they may deviate more, and from one side landmarks are not seen where
        they are from another: a wrong one is off by more than is usual.
    """
    segments, merges, d = refined.segments, refined.merges, refined.positions.shape[1]
    most, usual = usual, min(float(np.median(segments.residual)), usual)
    limit = usual * np.sqrt(chi2.isf(BY_CHANCE / max(len(merges.track), 1), d) / d)
    if most > 1 and len(merges.track):
        limit = max(limit, SPREAD * float(np.median(merges.residual)))
    off = merges.residual > max(limit, WORST * merges.residual.max(initial=0))
    torn = segments.first_iteration[segments.residual > TORN * usual]
    within = np.isin(rows.first_iteration[rows.segment], torn)
    within &= table.track_begin[rows.landmark] >= rows.first_iteration[rows.segment]
    tracks = np.union1d(merges.track[off], rows.landmark[within])
    tracks = tracks[np.isin(table.landmark_of[tracks], refined.landmarks)]
    return np.asarray(tracks[table.landmark_of[tracks] != tracks])


def places_of(
    table: LandmarkState, rows: SegmentRows, tracks: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where tracks (k,) of mapped landmarks were seen on the map (k, d), and how often (k,).

    Parameters
    ----------
    table : LandmarkState
    rows : SegmentRows
        By tracks.
    tracks : (k,) int64
    """
    landmark = table.landmark_of[rows.landmark]
    wanted = np.isin(rows.landmark, tracks)
    kept = (table.weight[landmark] > 0) & ~wanted
    placed, fixed = laid_on(rows, table.position, kept, landmark)
    at = np.flatnonzero(wanted & fixed)
    seen = np.zeros(len(table))
    np.add.at(seen, rows.landmark[at], rows.n_seen[at])
    places = np.zeros_like(table.position)
    np.add.at(places, rows.landmark[at], rows.n_seen[at][:, None] * placed[at])
    return places[tracks] / np.maximum(seen[tracks], 1)[:, None], seen[tracks]


def pieces(table: LandmarkState, rows: SegmentRows, submap: int) -> list[NDArray[np.int64]]:
    """Return the landmarks of a submap by what segments tie together, the largest piece first."""
    landmark = table.landmark_of[rows.landmark]
    on = table.submap[landmark] == submap
    on |= (table.submap[landmark] == NONE) & ~table.dynamic[landmark]
    n, m = rows.n_segments, len(table)
    ties = coo_array((np.ones(on.sum()), (landmark[on], m + rows.segment[on])), shape=(m + n,) * 2)
    piece = connected_components(ties, directed=False)[1][:m]
    own = np.flatnonzero(table.submap == submap)
    numbers, counts = np.unique(piece[own], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return [own[piece[own] == number] for number in numbers[order].tolist()]
