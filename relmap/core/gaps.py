"""What odometry adds to the map: it bridges the gaps that landmarks leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.association.sightings import rows_of_tracks
from relmap.core.mapper import RelativeMapper
from relmap.core.motion_noise import MotionNoise
from relmap.core.odometry import OdometryUse
from relmap.core.refinement.bridging import Bridged, bridge, measured_motions, noise_of
from relmap.core.refinement.chained import Sigmas
from relmap.core.refinement.chaining import PartSolver, Solved, join_parts
from relmap.core.refinement.condensing import SegmentRows
from relmap.core.refinement.extending import AGREEING
from relmap.core.refinement.joint import STEADY
from relmap.core.state.table import NONE

AGAIN = 2
"""Observations of a landmark that tell something of the others."""


def is_bridged(engine: RelativeMapper) -> bool:
    """Tell whether the map rests on odometry where landmarks leave gaps."""
    return engine.odometry is not None and engine.odometry.is_used


def bridge_gaps(engine: RelativeMapper, to_the_last: bool = False, is_open: bool = False) -> bool:
    """Put what odometry ties in one frame, where all that was seen agrees best with it.

    With `is_open`, loops were found that are still open.  Tells whether there was
    anything to do: where landmarks tie every scan, odometry adds nothing.
    """
    if not len(engine.motions):
        return False
    rows = engine.rows
    if not engine.association.has_ids:
        rows = rows_of_tracks(rows, engine.table)
    odometry = engine.motions.over(engine.store.n_iterations)
    measured = measured_motions(odometry, rows)
    noise, slipped = noise_of(odometry, measured, rows)
    before, use = engine.odometry, OdometryUse.of(noise, slipped)
    if before is not None:
        use = replace(use, drift=before.drift)
    if noise.is_wrong or not len(engine.kept):
        engine.odometry = use
        return False
    believed = noise.corrected(odometry)
    start, sigmas = None, None
    if before is not None and before.is_used:
        start, sigmas = before.poses if engine.refined else None, Sigmas(*before.sigmas.tolist())
    motions = np.where(slipped[:, None, None], measured.motion, believed)
    bridged = bridge(engine.table, rows, motions, start)
    hanging = bridged.hanging if before is None or sigmas is None else before.hanging
    if not len(hanging):
        engine.odometry = use
        return False
    solve = _solver(engine, rows, believed, noise, sigmas, to_the_last, is_open).solve
    bridged, solved = _solved(bridged, solve, engine.association.has_ids)
    cleared = _at_rest(engine, solved)
    if len(cleared):
        engine.table.dynamic[cleared] = False
        solved = solve(bridged)
    _place(engine, solved)
    engine.odometry = _in_use(use, solved, hanging, engine.store.n_iterations)
    return True


def _solved(
    bridged: Bridged, solve: Callable[[Bridged], list[Solved]], has_ids: bool
) -> tuple[Bridged, list[Solved]]:
    """Return the parts of a run, those joined that ids tie."""
    solved = solve(bridged)
    while has_ids and (joined := join_parts(bridged, solved)) is not None:
        bridged, solved = joined, solve(joined)
    return bridged, solved


def _solver(
    engine: RelativeMapper,
    rows: SegmentRows,
    believed: Floats,
    noise: MotionNoise,
    sigmas: Sigmas | None,
    to_the_last: bool,
    is_open: bool,
) -> PartSolver:
    """Return what solves the parts of a run; `believed` is odometry without constant errors."""
    mature = to_the_last and not engine.association.has_ids
    roots = None
    if len(engine.weighed) and not engine.association.estimates_covariances:
        # Observations before the first odometry are not kept.
        covariance = engine.weighed.covariance[len(engine.weighed) - len(engine.kept) :]
        roots = np.linalg.inv(np.linalg.cholesky(covariance))
    return PartSolver(
        engine.table,
        rows,
        engine.kept,
        roots,
        believed,
        noise,
        engine.averaging.noise.sigma_m,
        sigmas,
        to_the_last,
        engine.config.group_after // 2 if mature else AGAIN,
        is_open,
        engine.association.has_ids,
    )


def _at_rest(engine: RelativeMapper, solved: list[Solved]) -> Ints:
    """Return the landmarks (k,) taken for moving that keep their place as well as others do.

    Groups of two or three landmarks make more of noise than it is.
    """
    table, kept = engine.table, engine.kept
    poses = np.full((engine.store.n_iterations, 4, 4), np.nan)
    for part in solved[-1:]:
        poses[part.iterations] = part.poses
    d, landmark = kept.location.shape[1], table.now(kept.landmark)
    own = poses[kept.iteration]
    placed = np.einsum("nij,nj->ni", own[:, :d, :d], kept.location) + own[:, :d, 3]
    seen = np.isfinite(placed[:, 0])
    apart = np.full(len(table), np.nan)
    for one in np.unique(landmark[seen]):
        places = placed[seen & (landmark == one)]
        if len(places) >= engine.config.group_after:
            off = np.linalg.norm(places - np.median(places, axis=0), axis=1)
            apart[one] = np.quantile(off, AGREEING)
    still = apart[~table.dynamic & np.isfinite(apart)]
    usual = STEADY * float(np.median(still)) if len(still) else 0.0
    return np.flatnonzero(table.dynamic & (apart <= usual))


def _place(engine: RelativeMapper, solved: list[Solved]) -> None:
    """Put the landmarks of each part in a submap of its own; those of several go to the largest."""
    table = engine.table
    seen = np.bincount(table.now(engine.kept.landmark), minlength=len(table)).astype(np.float64)
    table.take_off_map(np.flatnonzero(table.submap != NONE))
    for part in solved:
        refined = part.refined
        own = refined.landmarks
        engine.map.place(engine.map.new_submap(), own, refined.positions, seen[own])
        table.highest_level[own] = np.maximum(table.highest_level[own], 1)
    drift = 1.0 if engine.odometry is None else engine.odometry.drift
    scaled = (replace(part.refined, spread=part.refined.spread.scaled(drift)) for part in solved)
    engine.refined = list(scaled)


def _in_use(
    use: OdometryUse, solved: list[Solved], hanging: Ints, n_iterations: int
) -> OdometryUse:
    """Return how odometry is used in a map of solved parts."""
    poses, sigmas = np.full((n_iterations, 4, 4), np.nan), np.ones(3)
    if solved:
        largest = solved[-1]
        poses[largest.iterations] = largest.poses
        sigmas = np.array(largest.sigmas)
    doubted = np.concatenate([use.left_out, *(part.doubted for part in solved)])
    return replace(
        use, is_used=True, left_out=np.unique(doubted), hanging=hanging, poses=poses, sigmas=sigmas
    )
