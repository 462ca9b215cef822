"""Extending a submap by landmarks connected to it through condensed segments.

A group needs several landmarks that stay in view together. A segment needs less: two mapped
landmarks (three in space) determine its pose, and so the positions of all other landmarks it saw.
Landmarks that no group could place, and those in separate submaps, are placed segment by segment,
the most certain first. The joint least squares then treats them like all others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import sums_each
from relmap.core.geometry.robust import fit_robust_each
from relmap.core.map.globalmap import GlobalMap
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import placed_segments
from relmap.core.refinement.trend import by_landmark, drifting
from relmap.core.state.table import NONE

TIERS = (3.0, 10.0, 100.0)
"""Largest variance of a position from a segment, relative to an observation, by stage."""
STEADY, LEAST_STEADY = 3.0, 0.95
"""Deviation up to which segments agree on a position, relative to the 95th percentile of the mapped
landmarks: landmarks are not equally noisy."""
AGREEING = 0.8
"""Fraction of the segments that must agree, as a landmark at rest half of the time is dynamic; and
of the landmarks of a submap that must fit one motion."""
CLOSELY = 0.5
"""Fraction of that deviation up to which a submap fits another, as three landmarks may place it. Of
38 right ones all but one have at most 0.31; two that mixed tracks moved by 1 to 3 m have at least
0.64."""
SHARE = 0.1
"""Least number of observations with a larger submap that move a landmark there, relative to those
with its present one."""
SURE = 3
"""Segments that must agree on the position of a landmark considered dynamic."""
SEEN_AGAIN = 2
"""Minimum number of observations to place a landmark: with fewer, errors are not detectable."""


class PlacedRows(NamedTuple):
    """The placed rows (n,): positions, variances, and allowed deviations."""

    placed: Floats
    variance: Floats
    limit: float


def extend_submaps(global_map: GlobalMap, rows: SegmentRows, among: Bools | None = None) -> bool:
    """Extend submaps, largest first, by landmarks of their segments; return whether any grew.

    Landmarks of smaller submaps move to the larger one, unless they are hardly seen with it: a few
    wrong ids contradict nothing in it. Landmarks considered dynamic that keep their position from
    segment to segment, without a trend, become static.

    `rows`: rows of all iterations. `among` (m,): landmarks that may be placed; all by default.
    """
    table = global_map.table
    seen = np.bincount(table.now(rows.landmark), rows.n_seen, minlength=len(table))
    often = seen >= SEEN_AGAIN if among is None else (seen >= SEEN_AGAIN) & among
    done = np.zeros(len(table), dtype=bool)
    grew = False
    for submap in table.submaps:
        for suspects in (False, True):
            grew |= _extend(global_map, submap, rows, often & ~done, suspects)
        own = np.flatnonzero(table.submap == submap)
        if len(own) < table.dimension:  # the remainder
            table.take_off_map(own)
        done[own] = True
    return grew


def join_seen_together(global_map: GlobalMap, rows: SegmentRows, spare: int = 1) -> bool:
    """Join submaps that segments show together; return whether any were.

    Segments that show more landmarks of the larger submap than determine their pose are placed in
    it, and the smaller one is moved as a whole to where they show its landmarks. A group may not
    have connected the two because few of their landmarks stayed in view together.

    `rows`: confirmed rows of all iterations. `spare`: landmarks of either submap that must be shown
    beyond those that determine a pose; with 0, a scan must show as many of both.
    """
    table, joined, more = global_map.table, False, True
    while more:
        more = False
        for submap in table.submaps:
            more |= _join_to(global_map, submap, rows, table.dimension + spare)
        joined |= more
    return joined


def _join_to(global_map: GlobalMap, submap: int, rows: SegmentRows, least: int) -> bool:
    """Join smaller submaps of which enough landmarks are shown; return whether there were any."""
    table, landmark = global_map.table, global_map.table.now(rows.landmark)
    known = table.submap[landmark] == submap
    # A landmark has several rows if its tracks were merged.
    pairs = np.unique(np.column_stack([rows.segment[known], landmark[known]]), axis=0)
    shown = np.bincount(pairs[:, 0], minlength=rows.n_segments)
    shared = landmark[shown[rows.segment] >= least]
    sizes = np.bincount(table.submap[table.submap != NONE])
    others = np.setdiff1d(table.submap[shared], [NONE, submap]).tolist()
    others = [other for other in others if sizes[other] <= sizes[submap]]
    if not others:
        return False
    fit = place_rows(rows, landmark, table.position, known)
    fit.variance[shown[rows.segment] < least] = np.inf
    joined = False
    for other in others:
        placement = _shown_at(global_map, other, rows, landmark, fit, known, least)
        if placement is not None:
            global_map.tie(other, submap, *placement)
            joined = True
    return joined


def _shown_at(
    global_map: GlobalMap,
    other: int,
    rows: SegmentRows,
    landmark: Ints,
    fit: PlacedRows,
    known: Bools,
    least: int,
) -> tuple[Floats, Floats] | None:
    """Return rotation and translation of a submap to where placed rows (n,) show its landmarks."""
    table = global_map.table
    shown = np.flatnonzero((table.submap[landmark] == other) & (fit.variance <= TIERS[1]))
    n_shown = len(np.unique(landmark[shown]))
    if least == table.dimension:
        tied = _at_once(rows, known, table.submap[landmark] == other, least)
        shown = shown[tied[rows.segment[shown]]]
    members, places, weights = _placed(rows, landmark, shown, fit, 1)
    if len(members) < least:
        return None
    at = np.zeros(len(members), dtype=np.int64)
    R, t, fixed, _ = fit_robust_each(table.position[members], places, weights, at, 1)
    shown = shown[np.isin(landmark[shown], members)]
    there = table.position[landmark[shown]] @ R[0].T + t[0]
    apart = np.linalg.norm(fit.placed[shown] - there, axis=1) / np.sqrt(fit.variance[shown])
    fitting = members[_upper(apart, landmark[shown]) <= CLOSELY * fit.limit]
    enough = max(least, AGREEING * n_shown)
    sure = fixed[0] and len(fitting) >= enough and global_map.is_fixed(other, fitting)
    return (R[0], t[0]) if sure else None


def _at_once(rows: SegmentRows, one: Bools, other: Bools, least: int) -> Bools:
    """Return in which segments a scan shows enough rows of one kind (n,) and of another (n,)."""
    at, scan = rows.sightings
    enough = np.minimum(np.bincount(scan, one[at]), np.bincount(scan, other[at])) >= least
    return np.bincount(rows.segment[at], enough[scan], rows.n_segments) > 0


def _extend(
    global_map: GlobalMap, submap: int, rows: SegmentRows, free: Bools, suspects: bool
) -> bool:
    """Extend one submap by free landmarks (m,), static or suspected to move."""
    table, tier, grew = global_map.table, 0, False
    landmark = table.now(rows.landmark)
    while tier < len(TIERS):
        known = table.submap == submap
        wanted = free & ~known & (table.dynamic == suspects)
        if not known.any() or not wanted[landmark].any():
            break
        fit = place_rows(rows, landmark, table.position, known[landmark])
        here = np.bincount(landmark, rows.n_seen * np.isfinite(fit.variance), len(table))
        wanted &= here >= SHARE * _seen_with_own(rows, landmark, table.submap)
        chosen = np.flatnonzero(wanted[landmark] & (fit.variance <= TIERS[tier]))
        if suspects:
            chosen = _resting(landmark, chosen, fit)
        placed = _placed(rows, landmark, chosen, fit, SURE if suspects else 1)
        if not len(placed[0]):
            tier += 1
            continue
        table.take_off_map(placed[0])
        table.dynamic[placed[0]] = False
        table.highest_level[placed[0]] = np.maximum(table.highest_level[placed[0]], 1)
        global_map.place(submap, *placed)
        tier, grew = 0, True
    return grew


def _seen_with_own(rows: SegmentRows, landmark: Ints, submap: Ints) -> Ints:
    """Return how often each landmark (m,) is seen in segments that its submap places."""
    own = submap[landmark]
    pairs = np.column_stack([rows.segment, own])
    of, counts = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)[1:]
    there = (own != NONE) & (counts[of] > rows.points.shape[1])
    return np.bincount(landmark[there], rows.n_seen[there], len(submap)).astype(np.int64)


def _resting(landmark: Ints, chosen: Ints, fit: PlacedRows) -> Ints:
    """Return the chosen rows of landmarks that have half of their rows among them, without a trend.

    In a map that is still bent, moving landmarks may keep their places as well as mapped ones.
    """
    n_rows, n_chosen = np.bincount(landmark), np.bincount(landmark[chosen])
    moving = drifting(landmark[chosen], fit.placed[chosen], len(n_chosen))
    rests = (2 * n_chosen >= n_rows[: len(n_chosen)]) & ~moving
    return np.asarray(chosen[rests[landmark[chosen]]])


def place_rows(rows: SegmentRows, landmark: Ints, positions: Floats, known: Bools) -> PlacedRows:
    """Align every segment to its known rows (n,), and return the variances of the others.

    If too few rows agree to determine a segment, or less than half, its variances are infinite.
    """
    n, d, of = rows.n_segments, rows.points.shape[1], rows.segment[known]
    placed, fixed, weight = placed_segments(rows, positions, known, landmark)
    agree = weight == 1
    counts = np.bincount(of[agree], minlength=n)
    enough = (counts >= d) & (2 * counts >= np.bincount(of, minlength=n))
    fixed &= enough[rows.segment]
    variance = _variances(rows, np.flatnonzero(known)[agree], n)
    variance[~fixed] = np.inf
    inside = np.flatnonzero(known & fixed)
    apart = np.linalg.norm(placed[inside] - positions[landmark[inside]], axis=1)
    deviation = _upper(apart / np.sqrt(variance[inside]), landmark[inside])
    usual = float(np.quantile(deviation, LEAST_STEADY)) if len(deviation) else 0.0
    return PlacedRows(placed, variance, STEADY * usual)


def _upper(values: Floats, of: Ints) -> Floats:
    """Return a high quantile of the values (n,) of each number in `of`."""
    order = np.lexsort((values, of))
    _, first, counts = np.unique(of[order], return_index=True, return_counts=True)
    return np.asarray(values[order][first + (AGREEING * counts).astype(np.int64)])


def _variances(rows: SegmentRows, fitted: Ints, n: int) -> Floats:
    """Return the variance (n,) of each row after fitting segments, relative to an observation."""
    at, d = rows.segment[fitted], rows.points.shape[1]
    seen = rows.n_seen[fitted].astype(np.float64)
    total = np.maximum(np.bincount(at, seen, minlength=n), 1e-300)
    centre = sums_each(seen[:, None] * rows.points[fitted], at, n) / total[:, None]
    away = rows.points - centre[rows.segment]
    outer = away[fitted][:, :, None] * away[fitted][:, None, :]
    scatter = sums_each(seen[:, None, None] * outer, at, n)
    trace = np.trace(scatter, axis1=1, axis2=2)
    square = np.sum(away**2, axis=1)
    if d == 2:
        turned = square / (2 * np.maximum(trace, 1e-280))[rows.segment]
    else:
        spread = np.linalg.pinv(trace[:, None, None] * np.eye(3) - scatter)[rows.segment]
        along = np.einsum("ni,nij,nj->n", away, spread, away)
        turned = (np.trace(spread, axis1=1, axis2=2) * square - along) / 3
    return np.asarray(1 / rows.n_seen + 1 / total[rows.segment] + turned)


def _placed(
    rows: SegmentRows, landmark: Ints, chosen: Ints, fit: PlacedRows, sure: int
) -> tuple[Ints, Floats, Floats]:
    """Return landmarks (k,), positions (k, d) and weights (k,) on which segments agree."""
    found: list[int] = []
    places, weights = [], []
    for number, rows_of in by_landmark(landmark[chosen], fit.placed[chosen]):
        if len(rows_of) < sure:
            continue
        of = chosen[rows_of]
        place = np.median(fit.placed[of], axis=0)
        apart = np.linalg.norm(fit.placed[of] - place, axis=1) / np.sqrt(fit.variance[of])
        if len(of) == 1 or np.sort(apart)[int(AGREEING * len(of))] <= fit.limit:
            found.append(number)
            places.append(place)
            weights.append(float(rows.n_seen[of].sum()))
    shape = len(found), fit.placed.shape[1]
    return np.array(found, dtype=np.int64), np.array(places).reshape(shape), np.array(weights)
