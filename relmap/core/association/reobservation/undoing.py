"""Undoing merges: tracks of a landmark that the refined map contradicts.

A landmark that mixes two objects pulls the map to where it fits neither. The residual of each of
its tracks in the least squares over all observations is compared with what the noise estimated
there explains.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import chdtri

from relmap.core.arrays import Floats, Ints
from relmap.core.association.reobservation.sightings import RARELY, Sightings
from relmap.core.geometry.alignment import sums_each
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined, laid_on
from relmap.core.state.table import NONE, LandmarkState

BY_CHANCE = 1e-3
"""Accepted expected number of correct merges undone per map."""
TORN = 3.0
"""Ratio to the usual residual above which a segment counts as misplaced."""
SPREAD = 4.0
"""Ratio to the usual residual above which a track is wrong, where noise does not explain the usual
one.
"""
CANDIDATES = 4
"""Landmarks near a track that are compared with its own."""
FAR_BETTER = 8.0
"""Squared misfit, in variances, by which one of them must fit better."""
WORST = 0.5
"""Fraction of the worst deviation above which others are undone with it: they may follow from
it."""


def contradicted(
    refined: Refined, table: LandmarkState, rows: SegmentRows, usual: float = 1.0
) -> Ints:
    """Return the merged tracks (k,) that a refined map contradicts.

    Those farther from their landmarks than noise explains, and those that began in segments with
    such residuals: such a segment is misplaced. The noise is taken from the median segment, because
    wrong merges increase the noise estimate of the map.

    `usual`: usual deviation of segments from the map, in units of what noise explains. Segments
    linked by odometry may deviate more, and landmarks may appear at different positions from
    different sides: a wrong merge deviates by more than is usual.
    """
    segments, merges, d = refined.segments, refined.merges, refined.positions.shape[1]
    if not len(segments.residual):
        return np.empty(0, dtype=np.int64)
    most, usual = usual, min(float(np.median(segments.residual)), usual)
    limit = usual * np.sqrt(chdtri(d, BY_CHANCE / max(len(merges.track), 1)) / d)
    if most > 1 and len(merges.track):
        limit = max(limit, SPREAD * float(np.median(merges.residual)))
    off = merges.residual > max(limit, WORST * merges.residual.max(initial=0))
    torn = segments.first_iteration[segments.residual > TORN * usual]
    within = np.isin(rows.first_iteration[rows.segment], torn)
    within &= table.track_begin[rows.landmark] >= rows.first_iteration[rows.segment]
    tracks = np.union1d(merges.track[off], rows.landmark[within])
    tracks = tracks[np.isin(table.landmark_of[tracks], refined.landmarks)]
    return np.asarray(tracks[table.landmark_of[tracks] != tracks])


def places_of(table: LandmarkState, rows: SegmentRows, tracks: Ints) -> tuple[Floats, Floats]:
    """Return the mean positions (k, d) of tracks (k,) of mapped landmarks, and counts (k,)."""
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


def nearer_another(
    refined: Refined, table: LandmarkState, rows: SegmentRows, sightings: Sightings
) -> Ints:
    """Return the merged tracks (k,) that another landmark of a refined map explains far better."""
    tracks = np.unique(refined.merges.track)
    if len(refined.landmarks) <= CANDIDATES or not len(tracks):
        return np.empty(0, dtype=np.int64)
    position, of = np.full(table.position.shape, np.nan), table.landmark_of
    position[refined.landmarks] = refined.positions
    kept = np.isfinite(position[of[rows.landmark], 0])
    placed, fixed = laid_on(rows, position, kept, of[rows.landmark])
    fixed &= kept
    seen = np.bincount(rows.landmark[fixed], rows.n_seen[fixed], len(table))
    sums = sums_each(rows.n_seen[fixed][:, None] * placed[fixed], rows.landmark[fixed], len(table))
    whole = np.bincount(of, seen, len(table))
    tracks = tracks[
        (seen[tracks] > 0) & (whole[of[tracks]] > seen[tracks]) & (of[tracks] != tracks)
    ]
    place, own = sums[tracks] / seen[tracks][:, None], of[tracks]
    rest = whole[own] - seen[tracks]
    without = (sums_each(sums, of, len(table))[own] - sums[tracks]) / rest[:, None]
    misfit = np.sum((place - without) ** 2, axis=1) / (1 / seen[tracks] + 1 / rest)
    _, near = cKDTree(refined.positions).query(place, CANDIDATES)
    other = refined.landmarks[near]
    apart = np.sum((place[:, None] - position[other]) ** 2, axis=2)
    apart /= 1 / seen[tracks][:, None] + 1 / np.maximum(whole[other], 1)
    apart[other == own[:, None]] = np.inf
    better = misfit - apart.min(axis=1) > FAR_BETTER * refined.noise_m**2
    best = other[np.arange(len(tracks)), apart.argmin(axis=1)]
    free = [
        not sightings.together(track, landmark, RARELY)
        for track, landmark in zip(tracks[better].tolist(), best[better].tolist(), strict=True)
    ]
    return np.asarray(tracks[better][np.array(free, dtype=bool)])


def pieces(table: LandmarkState, rows: SegmentRows, submap: int) -> list[Ints]:
    """Return the landmarks of a submap by connected component, the largest first."""
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
