"""Conversion of the engine's state to the results of a mapper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.core.landmarks import LandmarkMap, LandmarkTable, MappedGroup, Submap, in_space
from relmap.core.map.pose import trajectory
from relmap.core.mapper import RelativeMapper
from relmap.core.state.table import NONE, LandmarkState


def labels(engine: RelativeMapper) -> Ints:
    """Return the public labels of landmarks (n,)."""
    return engine.association.current.labels_of(np.arange(len(engine.table)))


def mapped_positions(engine: RelativeMapper, rank: int = 0) -> Floats:
    """Return the positions (n, d) in a submap, in its frame, metres; NaN for other submaps.

    `rank`: its index, 0 for the map itself.
    """
    return np.where(engine.map.ranks[:, None] == rank, engine.table.position, np.nan)


def mapped_covariances(engine: RelativeMapper) -> Floats:
    """Return the covariances (n, d, d) of the positions, square metres; NaN if unmapped.

    After refinement they come from the joint least squares, in the robot frame of the submap's
    first iteration. Before refinement they cover the averages only, not the drift of the chain.
    """
    table = engine.table
    mapped = engine.map.ranks == 0
    variance = engine.averaging.noise.sigma_m**2 / np.maximum(table.weight, 1)
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
        level=np.where(mapped, table.highest_level, 0)[order],
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


def path(engine: RelativeMapper, rank: int = 0) -> Floats:
    """Return ``T_submap_robot`` of every iteration (k, 4, 4); NaN where undetermined.

    `rank`: index of the submap, 0 for the map itself.
    """
    if engine.odometry is not None and engine.odometry.is_used:
        return engine.odometry.poses_in(engine.map.numbered(rank))
    positions = mapped_positions(engine, rank)
    noise_m = float(np.nan_to_num(engine.averaging.noise.sigma_m))
    return trajectory(engine.rows, positions, engine.table.landmark_of, noise_m)


def _moving_bins(table: LandmarkState, status: NDArray[np.str_], called: Ints) -> Ints:
    """Return for dynamic landmarks that move together the label (n,) of one of them, or `NONE`."""
    bins = np.where(status == "dynamic", table.moving_bin, NONE)
    _, first, members, sizes = np.unique(
        bins, return_index=True, return_inverse=True, return_counts=True
    )
    together = (bins != NONE) & (sizes[members] > 1)
    return np.where(together, called[first[members]], NONE)
