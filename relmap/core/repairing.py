"""Refinement of the whole map, and repair of merges that the refined map contradicts."""

from __future__ import annotations

import logging

import numpy as np

from relmap.core.afterwards import FEW, extend_by_ids, extent, find_again, rarely_seen, tie
from relmap.core.arrays import Bools, Ints
from relmap.core.association import Constellation
from relmap.core.association.reobservation.coinciding import compatible
from relmap.core.association.reobservation.few import Doubled
from relmap.core.association.reobservation.merging import doubtful, merge_doubles
from relmap.core.association.reobservation.recognition import CLEAR
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.association.reobservation.undoing import (
    contradicted,
    merged_across,
    nearer_another,
    places_of,
)
from relmap.core.association.scale import spacing_of
from relmap.core.connecting import connect
from relmap.core.gaps import is_bridged
from relmap.core.map.leaps import gaps_of
from relmap.core.map.pose import known_poses
from relmap.core.mapper import RelativeMapper
from relmap.core.rebuilding import rebuild
from relmap.core.refinement.assignment.reassigning import reassigned
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.hinges import Hinges, hinges_of
from relmap.core.refinement.misread import take_off_misread
from relmap.core.refining import ambiguous, is_unequal, refine_map
from relmap.core.revisiting import gather, merge_in_place, mergeable
from relmap.core.state.table import NONE

logger = logging.getLogger(__name__)

ROUNDS = 8
"""Maximum number of rounds of repairing and refining the map again."""
HANGING, LOOSE = 1.0, 0.5
"""Standard deviation of a landmark, relative to the size of the submap, above which a hinge
connects a part of it; and relative to the spacing of landmarks, above which they are of this part.
"""


def refine(engine: RelativeMapper) -> None:
    """Move all landmarks to the joint least-squares solution over all observations.

    Without ids, merges that the refined map contradicts are undone, remaining loops are closed,
    landmarks that coincide with compatible older ones are merged, and the map is refined again.
    With the paper's registration only coinciding landmarks are merged, once.
    """
    engine.refined, engine.hinges, association = [], None, engine.association
    # Of other registrations, many tracks mix several landmarks.
    may_repair = isinstance(association.registration, Constellation)
    refine_map(engine, to_the_last=not may_repair)
    more = False
    if may_repair:
        _repair(engine)
    elif association.is_known:
        more = _extend_by_ids(engine)
    elif not association.has_ids:
        more = merge_doubles(engine)
    if more:
        refine_map(engine)
    if association.is_known:
        rebuild(engine)
    while not is_bridged(engine) and _cut_loose(engine):
        refine_map(engine)
    for refined in engine.refined:
        if not refined.converged:
            logger.warning(
                "refinement of %d landmarks did not converge: the map is the best that was "
                "found, and its standard deviations may be wrong",
                len(refined.landmarks),
            )
    engine.hinges = _hinges(engine)
    engine.merger.look_again()


def _hinges(engine: RelativeMapper) -> Hinges | None:
    """Return how far off the refined map is expected to be; None with ids or odometry."""
    table, rows, ranks = engine.table, engine.rows, engine.map.ranks
    first = [refined for refined in engine.refined if not ranks[refined.landmarks].any()]
    if engine.association.has_ids or is_bridged(engine) or not first:
        return None
    positions = np.where(ranks[:, None] == 0, table.position, np.nan)
    known, poses = known_poses(rows, positions, table.landmark_of, engine.noise_m)
    gaps = gaps_of(rows, positions, table.landmark_of, known, poses[:, :3, 3])
    row = np.full(len(table), NONE)
    row[first[0].landmarks] = np.arange(len(first[0].landmarks))
    own = row[table.now(rows.landmark)]
    at, scan = rows.only(np.flatnonzero(own != NONE)).sightings
    shown = own[own != NONE][at[np.argsort(scan, kind="stable")]]
    ends = np.cumsum(np.bincount(scan, minlength=len(rows.iteration_segment)))
    by_scan = np.split(shown, ends[:-1])
    return hinges_of(first[0], gaps.before, gaps.after, lambda scan: np.unique(by_scan[scan]))


def _extend_by_ids(engine: RelativeMapper) -> bool:
    """Extend the submaps of a refined map with known ids; return whether the map has changed."""
    misread = take_off_misread(engine.map, engine.rows)
    others = ~np.isin(np.arange(len(engine.table)), misread)
    # With odometry every landmark is placed, and submaps of few landmarks are not remainders.
    grew = not is_bridged(engine) and extend_by_ids(engine, others)
    if grew:
        take_off_misread(engine.map, engine.rows)
    return grew or len(misread) > 0


def _repair(engine: RelativeMapper) -> None:
    """Repair a refined map and refine it again, as long as this changes enough."""
    grouped = engine.table.weight > 0
    mixes = _reassign_tracks(engine)  # tracks that mix landmarks hide doubles and open loops
    if mixes:
        refine_map(engine, to_the_last=False)
    for k in range(ROUNDS):
        before = extent(engine)[0]
        found, (after, mapped) = _look_over(engine), extent(engine)
        is_settled = not found or (k > 1 and before - after <= FEW * mapped)
        if is_settled and not _merge_doubled(engine) and not _connect(engine):
            break
    undone = _undo(engine)
    if is_bridged(engine):
        refine_map(engine, to_the_last=False)
        merge_in_place(engine)
        refine_map(engine)
        gather(engine)
    rare = rarely_seen(engine) & ~grouped
    if not is_bridged(engine):
        rare |= _wrong(engine)
    engine.table.take_off_map(np.flatnonzero(rare))
    if undone or rare.any() or engine.config.keep_observations or is_bridged(engine):
        refine_map(engine, to_the_last=not mixes)
    # Some that were parted while the map was distorted coincide in the last one.
    if not is_bridged(engine) and _merge_compatible(engine) | merge_doubles(engine):
        refine_map(engine, to_the_last=not mixes)
    if _reassign_tracks(engine):
        refine_map(engine)


def _wrong(engine: RelativeMapper) -> Bools:
    """Return which landmarks (m,) of a refined map are probably wrong matches of others.

    They have few observations, or occur in few of the scans that show their neighbours; and they
    are where another landmark is.
    """
    table = engine.table
    rare = rarely_seen(engine)
    wrong = doubtful(table, rare, engine.noise_m)
    seldom = Sightings(engine.rows, table).seldom(rare)
    if engine.association.current.is_blurred or is_unequal(engine):
        wrong |= rare & seldom
    for refined in engine.refined:
        own = np.isin(np.arange(len(table)), refined.landmarks)
        wrong |= doubtful(table, seldom & own, refined.noise_m)
    return wrong


def _look_over(engine: RelativeMapper) -> bool:
    """Undo merges that a refined map contradicts and find new ones; return whether any are new."""
    if _undo(engine):  # Otherwise wrong merges look right on the map that they have distorted.
        refine_map(engine, to_the_last=False)
    before = extent(engine)
    _merge_compatible(engine)
    tie(engine, [] if is_bridged(engine) else engine.refined)
    joined = find_again(engine)
    found = joined or extent(engine) != before
    if found:
        refine_map(engine, to_the_last=False)
    return found


def _merge_compatible(engine: RelativeMapper) -> bool:
    """Merge landmarks of unequal noise that coincide within the covariances of the refined map.

    Returns whether there were any.
    """
    merged = 0
    if not is_unequal(engine):
        return False
    sightings = Sightings(engine.rows, engine.table)
    for refined in engine.refined:
        pairs = refined.landmarks[compatible(refined.positions, refined.covariances)]
        merged += engine.merge_pairs(sightings.apart(mergeable(engine.table, pairs)))
    return merged > 0


def _merge_doubled(engine: RelativeMapper) -> bool:
    """Merge sets of few landmarks that are mapped twice and refine; return whether any were."""
    merged = 0
    if is_bridged(engine):
        return False
    for refined in engine.refined:
        for same in Doubled(refined, engine.table, engine.rows).sets():
            pairs = mergeable(engine.table, same)
            if len(pairs) > CLEAR * len(same):
                merged += engine.merge_pairs(pairs)
    if merged:
        refine_map(engine, to_the_last=False)
    return merged > 0


def _connect(engine: RelativeMapper) -> bool:
    """Connect parts that share few landmarks and refine; return whether there were any."""
    found = not is_bridged(engine) and connect(engine)
    if found:
        refine_map(engine, to_the_last=False)
    return found


def _undo(engine: RelativeMapper) -> int:
    """Undo the merges that the refined map contradicts; return how many."""
    table = engine.table
    rows = engine.rows
    usual = np.inf if is_bridged(engine) else 1.0
    each = [contradicted(refined, table, rows, usual) for refined in engine.refined]
    if not is_bridged(engine):
        sightings = Sightings(rows, table)
        each += [nearer_another(refined, table, rows, sightings) for refined in engine.refined]
        each += [merged_across(refined, table, rows) for refined in engine.refined]
    tracks = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *each]))
    engine.merger.n_undone += len(tracks)
    if len(tracks):
        _part(engine, rows, tracks)
    return len(tracks)


def _reassign_tracks(engine: RelativeMapper) -> bool:
    """Let each track stand for the landmark to which most of its observations are assigned.

    Returns whether tracks may mix landmarks; otherwise nothing is changed.
    """
    table, seen = engine.table, ambiguous(engine)
    if seen is None or is_bridged(engine):
        return False
    kept = engine.kept.landmark[~table.dynamic[table.now(engine.kept.landmark)]]
    goal = table.landmark_of.copy()
    for refined in engine.refined:
        now = reassigned(refined, *seen)
        pairs = np.stack([kept, now])[:, now != NONE]
        (track, landmark), counts = np.unique(pairs, axis=1, return_counts=True)
        most = 2 * counts > table.track_observations[track]
        goal[track[most]] = landmark[most]
    moved = goal != table.landmark_of
    changed = np.union1d(goal[moved], table.landmark_of[moved])
    some = np.flatnonzero(np.isin(goal, changed) | np.isin(table.landmark_of, changed))
    _part(engine, engine.rows, some[~table.is_own[some]])
    some = some[np.argsort(table.weight[some] == 0, kind="stable")]  # the oldest that is mapped
    first, of = np.unique(goal[some], return_index=True, return_inverse=True)[1:]
    pairs = np.column_stack([some, some[first[of]]])
    engine.merge_pairs(pairs[pairs[:, 0] != pairs[:, 1]])
    return True


def _cut_loose(engine: RelativeMapper) -> bool:
    """Cut off what only a hinge connects to the rest of a submap; return whether there is any.

    Two landmarks in space leave a rotation open. What is cut off is a submap, if there is enough.
    """
    found = False
    for refined in engine.refined:
        d, size_m = refined.positions.shape[1], np.ptp(refined.positions, axis=0).max()
        variance = np.trace(refined.covariances, axis1=1, axis2=2) / d
        sd = np.sqrt(np.where(np.isfinite(variance), variance, np.inf))
        loose = sd > LOOSE * spacing_of(refined.positions)
        if sd.max() <= HANGING * size_m or loose.all() or not loose.any():
            continue
        engine.table.submap[refined.landmarks[loose]] = engine.map.new_submap()
        for part in (refined.landmarks[loose], refined.landmarks[~loose]):
            if len(part) <= d:
                engine.table.take_off_map(part)
        found = True
    return found


def _part(engine: RelativeMapper, rows: SegmentRows, tracks: Ints) -> None:
    """Make merged tracks (k,) separate landmarks again, mapped where they were seen."""
    table = engine.table
    places, seen = places_of(table, rows, tracks)
    for track, place, weight in zip(tracks.tolist(), places, seen.tolist(), strict=True):
        landmark = int(table.landmark_of[track])
        table.part(track)
        engine.levels.close(np.array([track]))
        engine.schedule.part(track, engine.store.n_iterations)
        submap = int(table.submap[landmark])
        if weight > 0:
            at, of = np.array([track]), np.array([weight])
            engine.map.place(submap, at, place[None], of)
