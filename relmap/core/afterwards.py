"""Operations on the whole map, run when no scan follows for now; `repairing` refines it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relmap.core.arrays import Bools
from relmap.core.association.reobservation.disagreement import local_drift
from relmap.core.association.reobservation.loops import LoopFinder
from relmap.core.association.reobservation.merging import merge_doubles
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.association.reobservation.strays import find_strays
from relmap.core.association.reobservation.tying import NEIGHBOURHOOD, tie_submaps
from relmap.core.gaps import bridge_gaps, is_bridged, n_kept
from relmap.core.grouping.chart import PointChart
from relmap.core.grouping.dynamics import FEWEST
from relmap.core.map.bending import bend
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.confirming import found_rest, seen_in
from relmap.core.refinement.extending import extend_submaps, join_seen_together
from relmap.core.refinement.joint import CONFIRMED, Refined
from relmap.core.revisiting import (
    close_revisits,
    merge_doubles_in_place,
    merge_in_place,
    merge_within_drift,
)
from relmap.core.state.table import NONE
from relmap.core.turns import group_or_found, last_pass, placed_first

SEEDS = 20
"""Number of landmarks for which a late group is tried, most observed first."""
FEW = 0.01
"""Fraction of the landmarks that must change in a round, after the second, for another round to
follow: rounds that undo and repeat the same merges need not terminate."""
SELDOM = 0.5
"""Fraction of the usual number of observations below which a landmark is seldom seen."""
TIED = 0.85
"""Fraction of the scans that must match the one before if short tracks are to be mapped: in logs
with fewer, maps of such tracks were off by ten times the error of least squares."""


def finish(engine: RelativeMapper) -> None:
    """Group unmapped landmarks in view, and run the last pass of those that left."""
    in_view = engine.schedule.in_view
    # With fewer observations no landmark can be tested for rest, and none is grouped.
    for seed in in_view[engine.table.in_interval[in_view] >= FEWEST].tolist():
        if engine.table.weight[seed] == 0:
            group_or_found(engine, seed, 1)
    engine.schedule.end()
    gone = engine.schedule.gone
    for seed in gone[np.argsort(-engine.table.in_interval[gone], kind="stable")].tolist():
        if engine.table.is_gone[seed]:
            last_pass(engine, seed)
    if engine.association.is_known:
        extend_by_ids(engine)


def extend_by_ids(engine: RelativeMapper, among: Bools | None = None) -> bool:
    """Extend submaps by landmarks (m,), all by default, with known ids; return whether any grew.

    Single observations with wrong ids would place landmarks, and then poses, elsewhere, so they
    place only landmarks that no segment confirms, or that were considered dynamic, on which
    several must agree; with odometry none.
    """
    rows, table = engine.rows, engine.table
    among = np.ones(len(table), dtype=bool) if among is None else among
    sure = seen_in(rows, CONFIRMED)
    grew = extend_submaps(engine.map, sure, among)
    if len(engine.motions):
        free = among & (table.submap == NONE)
        return extend_submaps(engine.map, seen_in(rows, CONFIRMED - 1), free) or grew
    grew |= extend_submaps(engine.map, seen_in(rows, CONFIRMED - 1), among)
    grew |= join_seen_together(engine.map, rows, spare=0)
    brief = ~np.isin(np.arange(len(table)), table.now(sure.landmark))
    return extend_submaps(engine.map, rows, among & (brief | table.dynamic)) or grew


def found_late(engine: RelativeMapper, begin: int, end: int) -> None:
    """Start a submap from the stored iterations if no group placed any of them.

    If landmarks stay in view only briefly, none is due before it leaves.
    """
    landmarks = engine.store.seen(begin, end)[0]
    if not len(landmarks) or (engine.table.weight[landmarks] > 0).any():
        return
    times = np.bincount(landmarks)
    for seed in np.argsort(-times, kind="stable")[: min(SEEDS, np.count_nonzero(times))].tolist():
        first = placed_first(engine, PointChart.around(seed, engine.store, begin, end))
        if first is not None:
            placed, relative = first
            weights = relative.n_used.astype(np.float64)
            engine.map.place(engine.map.new_submap(), relative.landmarks, placed, weights)
            return


def tie(engine: RelativeMapper, refined: Sequence[Refined] = ()) -> None:
    """Join submaps that show the same place, close loops, and merge re-observed landmarks.

    `refined`: the submaps, if they were just refined.
    """
    noise_m, merger = engine.noise_m, engine.merger
    rows = engine.rows
    merger.sightings = Sightings(rows, engine.table)
    drift = local_drift(engine.table, rows, noise_m)
    for _ in tie_submaps(engine.map, noise_m, drift, refined):
        merge_doubles(engine)
    if is_bridged(engine):
        close_revisits(engine)
        merge_in_place(engine)
        merge_within_drift(engine)
        merge_doubles_in_place(engine)
    else:
        _close_loops(engine, rows, noise_m, drift)
        if engine.refined:  # Before that, coinciding landmarks may be distinct.
            merge_doubles(engine)
    merger.sightings = None


def complete(engine: RelativeMapper) -> None:
    """Connect a map of points by odometry, and without ids tie what shows the same place.

    With odometry the map is then solved again, as long as ties merge enough: merging distributes
    the drift, which lets more landmarks coincide. Landmarks that odometry placed are unmapped if
    they have fewer observations than a group needs. If odometry places nothing, submaps are
    extended by single observations with ids.
    """
    if not bridge_gaps(engine) and engine.association.is_known and len(engine.motions):
        extend_submaps(engine.map, engine.rows)
    more = not engine.association.has_ids
    while more:
        before = extent(engine)[0]
        tie(engine)
        after, mapped = extent(engine)
        more = is_bridged(engine) and before - after > FEW * mapped
        if is_bridged(engine) and before != after:
            bridge_gaps(engine)
    if is_bridged(engine) and not engine.association.has_ids:
        engine.table.take_off_map(np.flatnonzero(rarely_seen(engine)))
        is_left = engine.table.weight > 0
        each = [one.only(is_left[one.landmarks]) for one in engine.refined]
        engine.refined = [one for one in each if len(one.landmarks)]


def _close_loops(engine: RelativeMapper, rows: SegmentRows, noise_m: float, drift: float) -> None:
    """Close loops that drift has left open, one after the other."""
    finder = LoopFinder(
        engine.table, noise_m, drift=drift, is_blurred=engine.association.current.is_blurred
    )
    while (loop := finder.next()) is not None:
        pairs, placement = loop
        bend(engine.map, rows, pairs, placement.R, placement.t)
        engine.merge_pairs(pairs)
        merge_doubles(engine)


def find_again(engine: RelativeMapper) -> bool:
    """Match unmatched scans to the map, and to what these scans themselves add to it.

    Then join submaps that scans show together; returns whether any were.
    """
    table, rows, noise_m = engine.table, engine.rows, engine.noise_m
    found = True
    while found:
        extend_submaps(engine.map, rows, (table.submap == NONE) & ~table.dynamic)
        found = False
        drift = local_drift(table, rows, noise_m)
        for pairs in find_strays(table, rows, noise_m, drift):
            found |= engine.merge_pairs(pairs) > 0
    if is_bridged(engine):
        return False
    sure = seen_in(rows, CONFIRMED)
    joined = join_seen_together(engine.map, sure)
    if _is_brief(engine, rows):  # Otherwise groups start submaps.
        found_rest(engine.map, sure, NEIGHBOURHOOD)
        extend_submaps(engine.map, rows, (table.submap == NONE) & ~table.dynamic)
    return joined


def rarely_seen(engine: RelativeMapper) -> Bools:
    """Return which landmarks (m,) are mapped with fewer observations than a group needs.

    Where landmarks stay in view too briefly for groups, fewer than half of the usual number.
    """
    table, enough = engine.table, float(engine.config.group_after)
    if is_bridged(engine):  # Scans of one or two landmarks are in no segment.
        seen = n_kept(engine)
    else:
        rows = engine.rows
        seen = np.bincount(table.now(rows.landmark), rows.n_seen, len(table)).astype(np.float64)
        if _is_brief(engine, rows):
            enough = SELDOM * _usually(rows)
    return np.asarray((table.weight > 0) & (seen < enough))


def _is_brief(engine: RelativeMapper, rows: SegmentRows) -> bool:
    """Return whether most landmarks stay in view too briefly for a group, though scans match.

    Where scans do not match, tracks are short too, and many of them are wrong.
    """
    tied = engine.association.current.tied_share
    return tied is not None and tied >= TIED and _usually(rows) < engine.config.group_after


def _usually(rows: SegmentRows) -> float:
    """Return the number of observations of the track of the median observation.

    Tracks seen once or twice do not count: many are false detections.
    """
    seen = np.sort(np.bincount(rows.landmark, rows.n_seen))
    seen = seen[seen >= CONFIRMED]
    return float(seen[np.searchsorted(np.cumsum(seen), seen.sum() / 2)]) if len(seen) else 0.0


def extent(engine: RelativeMapper) -> tuple[int, int]:
    """Return the number of landmarks, and how many of them are mapped."""
    return int(engine.table.is_own.sum()), int((engine.table.weight > 0).sum())
