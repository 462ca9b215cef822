"""Connecting the parts of a refined map that share few landmarks."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.reobservation.crossing import Part
from relmap.core.association.reobservation.disagreement import local_drift
from relmap.core.association.reobservation.evidence import LOCAL_DRIFT
from relmap.core.association.reobservation.few import FEWEST
from relmap.core.association.reobservation.shapes import is_known, joint_covariance
from relmap.core.association.reobservation.sharing import FewShared
from relmap.core.association.reobservation.sightings import Sightings
from relmap.core.association.reobservation.tying import is_regular
from relmap.core.map.pose import known_poses
from relmap.core.mapper import RelativeMapper
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.joint import Refined
from relmap.core.revisiting import mergeable


def connect(engine: RelativeMapper) -> bool:
    """Tie submaps that share few landmarks, and match scans; return whether the map changed.

    Scans that show few landmarks are matched to what was seen just before and after them.
    """
    table, refined = engine.table, [one for one in engine.refined if is_known(one)]
    if not refined:
        return False
    rows = engine.rows
    drift = local_drift(table, rows, engine.noise_m) - LOCAL_DRIFT
    submaps = [_submap(engine, rows, one, drift) for one in refined]
    if is_regular([(part.positions, part.noise_m) for part in submaps]):
        return False
    shared = FewShared(submaps, list(_strays(engine, rows, drift)))
    sightings = Sightings(rows, table)
    ties = [tie for tie in shared.ties() if _are_apart(sightings, tie.pairs)]
    matches = [pairs for pairs in shared.matches() if _are_apart(sightings, pairs)]
    for tie in ties:
        other, submap = (int(table.submap[of]) for of in tie.pairs[0])
        engine.map.tie(other, submap, tie.placement.R, tie.placement.t)
        engine.merge_pairs(mergeable(table, tie.pairs))
    n_merged = 0
    for pairs in matches:
        now = table.now(pairs)  # A track may be in two scans, and a landmark in what was tied.
        n_merged += engine.merge_pairs(now[table.weight[now[:, 0]] == 0])
    return len(ties) > 0 or n_merged > 0


def _are_apart(sightings: Sightings, pairs: Ints) -> bool:
    """Return whether no scan shows both landmarks of one of some pairs (k, 2)."""
    return len(sightings.apart(pairs)) == len(pairs)


def _submap(engine: RelativeMapper, rows: SegmentRows, refined: Refined, drift: float) -> Part:
    """Return a refined submap and the robot's way in it."""
    table, d = engine.table, engine.table.dimension
    positions = np.full(table.position.shape, np.nan)
    positions[refined.landmarks] = refined.positions
    known, poses = known_poses(rows, positions, table.landmark_of, engine.noise_m)
    return Part(
        refined.landmarks,
        refined.positions,
        partial(joint_covariance, refined, variance=drift),
        refined.noise_m,
        known,
        poses[:, :d, 3],
        poses[:, :d, :d],
    )


def _strays(engine: RelativeMapper, rows: SegmentRows, drift: float) -> Iterator[Part]:
    """Yield the segments that show enough landmarks, but too few of the map to have a pose."""
    table, noise_m = engine.table, engine.noise_m
    landmark, n, d = table.now(rows.landmark), rows.n_segments, table.dimension
    mapped = table.weight[landmark] > 0
    free = ~mapped & ~table.dynamic[landmark]
    shown, unmapped = (np.bincount(rows.segment[of], minlength=n) for of in (mapped, free))
    n_seen, every = rows.n_seen, np.arange(n + 1)
    first = np.searchsorted(rows.segment, every)
    by_segment = np.argsort(rows.iteration_segment, kind="stable")
    begin = np.searchsorted(rows.iteration_segment[by_segment], every)
    for segment in np.flatnonzero((shown < d) & (unmapped >= FEWEST)).tolist():
        own = np.arange(first[segment], first[segment + 1])
        own = own[free[own]]
        own = own[np.unique(landmark[own], return_index=True)[1]]
        variance = noise_m**2 * (1 / n_seen[own] + drift)
        iterations = by_segment[begin[segment] : begin[segment + 1]]
        covariance = partial(_independent, variance, d)
        if len(own) >= FEWEST:
            yield Part(
                landmark[own],
                rows.points[own],
                covariance,
                noise_m,
                iterations,
                rows.t[iterations],
                rows.R[iterations],
            )


def _independent(variance: Floats, d: int, rows: Ints) -> Floats:
    """Return the covariance (k d, k d) of rows (k,) with a variance (n,) of each coordinate."""
    return np.diag(np.repeat(variance[rows], d))
