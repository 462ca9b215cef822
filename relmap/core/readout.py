"""Conversion of the engine's state to the results of a mapper."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.gaps import is_bridged
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup, Submap, in_space
from relmap.core.map.leaps import Gaps, gaps_of
from relmap.core.map.lengths import length_ratio
from relmap.core.map.pose import known_poses, weigh_poses
from relmap.core.map.unseen import Part, contradicting
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.creeping import creep_of
from relmap.core.state.table import NONE, LandmarkState


def labels(engine: RelativeMapper) -> Ints:
    """Return the public labels of landmarks (n,)."""
    return engine.association.current.labels_of(np.arange(len(engine.table)))


def mapped_positions(engine: RelativeMapper) -> Floats:
    """Return the positions (n, d) in the map, map frame, metres; NaN for other submaps."""
    return np.where(engine.map.ranks[:, None] == 0, engine.table.position, np.nan)


def mapped_covariances(engine: RelativeMapper) -> Floats:
    """Return the covariances (n, d, d) of the positions, square metres; NaN if unmapped.

    After refinement they come from the joint least squares, in the robot frame of the submap's
    first iteration. Before refinement they cover the averages only, not the drift of the chain.
    """
    table = engine.table
    mapped = engine.map.ranks == 0
    variance = engine.noise_m**2 / np.maximum(table.weight, 1)
    covariances: Floats = variance[:, None, None] * np.eye(table.dimension)
    for submap in engine.refined:
        if mapped[submap.landmarks].any():
            covariances[submap.landmarks] = submap.covariances
    covariances[~mapped] = np.nan
    return covariances


def landmark_map(engine: RelativeMapper) -> LandmarkMap:
    """Return the map, the first submap, in ascending order of labels."""
    called, d = labels(engine), engine.table.dimension
    members = np.flatnonzero(engine.map.ranks == 0)
    members = members[np.argsort(called[members])]
    covariances = np.zeros((len(members), 3, 3))
    covariances[:, :d, :d] = mapped_covariances(engine)[members]
    return LandmarkMap(called[members], in_space(engine.table.position[members]), covariances)


def landmark_table(engine: RelativeMapper) -> LandmarkTable:
    """Return the table of all landmarks, in ascending order of labels.

    Landmarks merged into another are omitted.
    """
    table, called = engine.table, labels(engine)
    order = np.argsort(called)
    order = order[table.is_own[order]]
    rank = engine.map.ranks
    mapped = rank == 0
    status = np.where(mapped, "static", np.where(table.dynamic, "dynamic", "unmapped"))
    covariances = mapped_covariances(engine)
    variance = np.trace(covariances, axis1=1, axis2=2) / max(covariances.shape[1], 1)
    return LandmarkTable(
        landmark=called[order],
        position=in_space(mapped_positions(engine))[order],
        sd=np.sqrt(variance)[order],
        observations=table.observations[order],
        first_iteration=table.first[order],
        last_iteration=table.last[order],
        level=np.where(mapped, table.highest_level, 0)[order].astype(np.int64),
        status=status[order],
        submap=rank[order],
        moving_bin=_moving_bins(table, status, called)[order],
    )


def map_submaps(engine: RelativeMapper) -> list[Submap]:
    """Return the submaps, the map first, the others by size."""
    table, called = engine.table, labels(engine)
    rank = engine.map.ranks
    submaps = []
    for submap in range(int(rank.max(initial=NONE)) + 1):
        members = np.flatnonzero(rank == submap)
        members = members[np.argsort(called[members])]
        positions = in_space(table.position[members])
        seen = int(table.first[members].min()), int(table.last[members].max())
        submaps.append(Submap(called[members], positions, *seen))
    return submaps


def mapped_groups(engine: RelativeMapper) -> list[MappedGroup]:
    """Return the groups behind the map, in the order in which they were placed."""
    called, of = labels(engine), engine.table.landmark_of
    return [replace(group, landmarks=called[of[group.landmarks]]) for group in engine.levels.groups]


def path(engine: RelativeMapper) -> Floats:
    """Return ``T_map_robot`` of every iteration (k, 4, 4); NaN where undetermined."""
    if engine.odometry is not None and engine.odometry.is_used:
        return engine.odometry.poses_in(engine.map.first)
    poses = np.full((len(engine.rows.iteration_segment), 4, 4), np.nan)
    at, known = _known_poses(engine, engine.rows, mapped_positions(engine))
    poses[at] = known
    return poses


def gaps(engine: RelativeMapper, known: Ints, places_map: Floats) -> Gaps | None:
    """Return the gaps that only places which look the same bridge; None with ids or odometry.

    `known` (k,): iterations with a pose, ascending; `places_map` (k, 3): positions, metres.
    """
    if is_bridged(engine) or engine.association.has_ids or not len(engine.table):
        return None
    positions, of = mapped_positions(engine), engine.table.landmark_of
    return gaps_of(engine.rows, positions, of, known, places_map)


def creep(engine: RelativeMapper) -> float | None:
    """Return how fast landmarks of the refined map creep, see `creep_of`; None if not refined."""
    if not engine.refined:
        return None
    rows, table = engine.rows, engine.table
    return creep_of(rows, table.position, engine.map.ranks == 0, table.now(rows.landmark))


def contradicted_at(engine: RelativeMapper) -> list[int | None]:
    """Return for each submap the iteration that contradicts it, see `contradicting`, if one does.

    None before refinement, and with ids or odometry.
    """
    found, ranks = paths(engine), engine.map.ranks
    if is_bridged(engine) or engine.association.has_ids or not engine.refined:
        return [None] * len(found)
    parts = [Part(engine.table.position[ranks == k], *own) for k, own in enumerate(found)]
    return contradicting(engine.rows, parts, _noise_m(engine))


def added_lengths(engine: RelativeMapper) -> float | None:
    """Return lengths in an added log relative to those of the map, if these differ."""
    table, since = engine.table, engine.map.kept_until
    if not since:
        return None
    old = np.where(table.first[:, None] < since, mapped_positions(engine), np.nan)
    return length_ratio(engine.rows, old, table.landmark_of, since)


def paths(engine: RelativeMapper) -> list[tuple[Ints, Floats]]:
    """Return the iterations (p,) with a pose in each submap, and the poses (p, 4, 4)."""
    ranks, of, found = engine.map.ranks, engine.table.landmark_of, list[tuple[Ints, Floats]]()
    n_submaps = int(ranks.max(initial=NONE)) + 1
    if engine.odometry is not None and engine.odometry.is_used:
        for rank in range(n_submaps):
            number = int(engine.table.submap[ranks == rank][0])
            inside = np.flatnonzero(engine.odometry.submap == number)
            found.append((inside, engine.odometry.poses[inside]))
        return found
    rows = engine.rows
    rank_of = ranks[of[rows.landmark]]
    order = np.argsort(rank_of, kind="stable")
    begins = np.searchsorted(rank_of[order], np.arange(n_submaps + 1))
    for begin, end in pairwise(begins.tolist()):
        positions = np.where(ranks[:, None] == len(found), engine.table.position, np.nan)
        found.append(_known_poses(engine, rows.only(order[begin:end]), positions))
    return found


def _known_poses(
    engine: RelativeMapper, rows: SegmentRows, positions: Floats
) -> tuple[Ints, Floats]:
    """Return the iterations (p,) whose pose the landmarks at positions (m, d) tell, and these."""
    of, kept = engine.table.landmark_of, engine.kept
    known, poses = known_poses(rows, positions, of, _noise_m(engine))
    if len(kept.covariance):
        weigh_poses(known, poses, kept, positions, of)
    return known, poses


def _noise_m(engine: RelativeMapper) -> float:
    return float(np.nan_to_num(engine.noise_m))


def _moving_bins(table: LandmarkState, status: NDArray[np.str_], called: Ints) -> Ints:
    """Return for dynamic landmarks that move together the label (n,) of one of them, or `NONE`."""
    bins = np.where(status == "dynamic", table.moving_bin, NONE)
    _, first, members, sizes = np.unique(
        bins, return_index=True, return_inverse=True, return_counts=True
    )
    together = (bins != NONE) & (sizes[members] > 1)
    return np.where(together, called[first[members]], NONE)
