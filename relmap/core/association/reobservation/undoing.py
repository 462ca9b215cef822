"""Undoing merges: tracks of a landmark that the refined map contradicts.

A landmark that mixes two objects pulls the map to where it fits neither. The residual of each of
its tracks in the least squares over all observations is compared with what the noise estimated
there explains.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri

from relmap.core.arrays import Floats, Ints
from relmap.core.association.reobservation.sightings import RARELY, Sightings
from relmap.core.association.scale import spacing_of
from relmap.core.geometry.alignment import sums_each
from relmap.core.map.leaps import HIGHEST, LOWEST, Gaps, gaps_of, may_have_gaps
from relmap.core.map.pose import known_poses
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined, placed_segments
from relmap.core.state.table import LandmarkState

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
TOO_FAR, AROUND = 2.0, 16
"""Step of the robot across a gap, in usual ones, from which merges across the gap are wrong; and
the iterations before and after it that show what was merged."""
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
    if not len(segments.residual) or refined.is_exact:
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
    placed, fixed, _ = placed_segments(rows, table.position, kept, landmark)
    at = np.flatnonzero(wanted & fixed)
    track, n_seen = rows.landmark[at], rows.n_seen[at]
    seen = np.asarray(np.bincount(track, n_seen, len(table)), dtype=np.float64)
    places = sums_each(n_seen[:, None] * placed[at], track, len(table))
    return places[tracks] / np.maximum(seen[tracks], 1)[:, None], seen[tracks]


class _Placed:
    """Tracks placed by segments aligned to a refined map.

    Attributes: `position` (m, d), metres: of the landmarks of the map, others are NaN; `seen` (m,):
    number of observations of each track, and `whole` (m,), of each landmark; `sums` (m, d), metres:
    sum of the positions of each track; `misfit` (m,), square metres: squared distance of the mean
    of each track from the rest of its landmark, scaled to the variance of one observation.
    """

    def __init__(self, refined: Refined, table: LandmarkState, rows: SegmentRows) -> None:
        self.position, of = np.full(table.position.shape, np.nan), table.landmark_of
        self.position[refined.landmarks] = refined.positions
        kept = np.isfinite(self.position[of[rows.landmark], 0])
        placed, fixed, _ = placed_segments(rows, self.position, kept, of[rows.landmark])
        fixed &= kept
        track, n_seen = rows.landmark[fixed], rows.n_seen[fixed]
        self.seen = np.bincount(track, n_seen, len(table))
        self.sums = sums_each(n_seen[:, None] * placed[fixed], track, len(table))
        self.whole = np.bincount(of, self.seen, len(table))
        rest, sums = self.whole[of] - self.seen, sums_each(self.sums, of, len(table))[of]
        known = np.flatnonzero((self.seen > 0) & (rest > 0))
        apart = self.mean(known) - (sums - self.sums)[known] / rest[known][:, None]
        self.misfit = np.zeros(len(table))
        self.misfit[known] = np.sum(apart**2, axis=1) / (1 / self.seen[known] + 1 / rest[known])

    def mean(self, tracks: Ints) -> Floats:
        """Return the mean positions (k, d) of tracks (k,)."""
        return np.asarray(self.sums[tracks] / self.seen[tracks][:, None])


def nearer_another(
    refined: Refined, table: LandmarkState, rows: SegmentRows, sightings: Sightings
) -> Ints:
    """Return the merged tracks (k,) that another landmark of a refined map explains far better."""
    tracks, of = np.unique(refined.merges.track), table.landmark_of
    if len(refined.landmarks) <= CANDIDATES or not len(tracks) or refined.is_exact:
        return np.empty(0, dtype=np.int64)
    placed, enough = _Placed(refined, table, rows), FAR_BETTER * refined.noise_m**2
    tracks = tracks[(placed.misfit[tracks] > 0) & (of[tracks] != tracks)]
    place, misfit = placed.mean(tracks), placed.misfit[tracks]
    _, near = cKDTree(refined.positions).query(place, CANDIDATES)
    other = refined.landmarks[near]
    apart = np.sum((place[:, None] - placed.position[other]) ** 2, axis=2)
    apart /= 1 / placed.seen[tracks][:, None] + 1 / np.maximum(placed.whole[other], 1)
    apart[other == of[tracks][:, None]] = np.inf
    best, least = other[np.arange(len(tracks)), apart.argmin(axis=1)], apart.min(axis=1)
    better = misfit - least > enough
    pairs = zip(tracks[better].tolist(), best[better].tolist(), strict=True)
    found = [track for track, rival in pairs if not sightings.together(track, rival, RARELY)]
    return np.array(found, dtype=np.int64)


def merged_across(refined: Refined, table: LandmarkState, rows: SegmentRows) -> Ints:
    """Return the tracks (k,) merged across gaps in which the robot moves too far.

    No track bridges such a gap. What was merged across it while the map had drifted by more than
    the spacing of landmarks holds its two sides apart, and their true landmarks remain doubled.
    """
    positions, of = np.full(table.position.shape, np.nan), table.landmark_of
    positions[refined.landmarks] = refined.positions
    if not may_have_gaps(rows, positions, of):
        return np.empty(0, dtype=np.int64)
    known, poses = known_poses(rows, positions, of, refined.noise_m)
    begin, landmark = rows.first_iteration[rows.segment], of[rows.landmark]
    first, last = begin + LOWEST[rows.visible], begin + HIGHEST[rows.visible]
    found = [np.empty(0, dtype=np.int64)]
    gaps = gaps_of(rows, positions, of, known, poses[:, :3, 3])
    row, scan = rows.sightings  # a single scan shows no landmark twice
    spacing_m = spacing_of(rows.points[row[scan == np.bincount(scan).argmax()]])
    for before, after in _torn(gaps, known, poses, spacing_m):
        on = (first <= before) & (last > before - AROUND)
        off = (last >= after) & (first < after + AROUND)
        found.append(np.intersect1d(landmark[on], landmark[off]))
    tracks = np.flatnonzero(np.isin(of, np.intersect1d(np.concatenate(found), refined.landmarks)))
    return np.asarray(tracks[of[tracks] != tracks])


def _torn(gaps: Gaps, known: Ints, poses: Floats, spacing_m: float) -> list[tuple[int, int]]:
    """Return the last iteration before, and the first one after, each gap of too long a step.

    By `spacing_m`, the distance of landmarks, at least: steps of a slow robot are doubled by the
    noise of its poses. Not beside another such step: there a single scan is misplaced. `known`
    (p,): iterations of `poses` (p, 4, 4), ascending.
    """
    usual_m = gaps.reach_m / (gaps.after - gaps.before)
    each_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / np.diff(known)
    each_m, at = np.concatenate([[0.0], each_m, [0.0]]), np.searchsorted(known, gaps.before) + 1
    beside_m = np.maximum(each_m[at - 1], each_m[at + 1])
    torn = (gaps.way_m > TOO_FAR * gaps.reach_m) & (beside_m <= TOO_FAR * usual_m)
    torn &= gaps.way_m > gaps.reach_m + spacing_m
    return list(zip(gaps.before[torn].tolist(), gaps.after[torn].tolist(), strict=True))
