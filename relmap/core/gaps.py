"""Connecting parts of the map by odometry where landmarks leave gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.mapper import RelativeMapper
from relmap.core.odometry import OdometryUse
from relmap.core.refinement.chain.bridging import Bridged, bridge, measured_motions, noise_of
from relmap.core.refinement.chain.chain_data import Sigmas
from relmap.core.refinement.chain.chaining import PartSolver, Solved, join_parts
from relmap.core.refinement.chain.resting import at_rest, placed_observations
from relmap.core.state.table import NONE


def is_bridged(engine: RelativeMapper) -> bool:
    """Return whether the map depends on odometry where landmarks leave gaps."""
    return engine.odometry is not None and engine.odometry.is_used


def n_kept(engine: RelativeMapper) -> Floats:
    """Return the number of observations of each landmark (m,) that are kept."""
    kept, table = engine.kept, engine.table
    return np.asarray(np.bincount(table.now(kept.landmark), kept.count, len(table)), np.float64)


def bridge_gaps(engine: RelativeMapper, to_the_last: bool = False) -> bool:
    """Place all parts connected by odometry in one frame, by joint least squares.

    Returns whether there was anything to do: if landmarks connect all scans, odometry adds nothing.
    """
    if not len(engine.motions):
        return False
    rows = engine.rows
    odometry = engine.motions.over(engine.store.n_iterations)
    measured = measured_motions(rows)
    noise, slipped, missed = noise_of(odometry, measured, rows)
    before, use = engine.odometry, OdometryUse.of(noise, slipped | missed)
    if before is not None:
        use = replace(use, drift=before.drift, alike=before.alike)
    if noise.is_wrong or not len(engine.kept):
        engine.odometry = use
        return False
    corrected = noise.corrected(odometry)
    start, sigmas = None, None
    if before is not None and before.is_used:
        start = before.poses_in(engine.map.first) if engine.refined else None
        sigmas = Sigmas(*before.sigmas.tolist())
    corrected[missed] = np.nan
    motions = np.where((slipped | missed)[:, None, None], measured.motion, corrected)
    bridged = bridge(engine.table, rows, motions, float(np.nan_to_num(engine.noise_m)), start)
    hanging = bridged.hanging if before is None or sigmas is None else before.hanging
    hanging = hanging[np.isfinite(odometry[hanging, 0, 0])]  # Others are not connected at all.
    if not len(hanging):
        engine.odometry = use
        return False
    solver = PartSolver(engine, rows, corrected, noise, sigmas, to_the_last)
    judges = to_the_last or not engine.refined
    solved = _judged(engine, bridged, solver) if judges else _solved(engine, bridged, solver)[1]
    numbers = _place(engine, solved)
    use = _in_use(use, solved, numbers, hanging, engine.store.n_iterations)
    named = np.concatenate([numbers[:0], *(part.of_two_places for part in solved)])
    engine.odometry = replace(use, of_two_places=engine.association.current.labels_of(named))
    return True


def _judged(engine: RelativeMapper, bridged: Bridged, solver: PartSolver) -> list[Solved]:
    """Return the parts of a run, solved without landmarks that move in them.

    Those considered dynamic are solved for as static first: if they are at rest, the poses agree
    with them within the noise of odometry, and a robust solution leaves out those that are not.
    """
    # Groups of two or three landmarks underestimate the noise.
    often = n_kept(engine) >= engine.config.group_after
    suspects = np.flatnonzero(engine.table.dynamic & often)
    engine.table.dynamic[suspects] = False
    bridged, solved = _solved(engine, bridged, solver)
    moving = _moving(engine, solved, suspects)
    engine.table.dynamic[moving] = True
    return solver.solve(bridged, solved) if len(moving) else solved


def _solved(
    engine: RelativeMapper, bridged: Bridged, solver: PartSolver
) -> tuple[Bridged, list[Solved]]:
    """Return the parts of a run; parts with common ids are joined."""
    solved, has_ids = solver.solve(bridged), engine.association.has_ids
    while has_ids and (joined := join_parts(bridged, solved)) is not None:
        bridged, solved = joined, solver.solve(joined)
    return bridged, solved


def _moving(engine: RelativeMapper, solved: list[Solved], suspects: Ints) -> Ints:
    """Return the suspects (k,) that do not keep their place where they were solved for."""
    if not len(suspects):
        return suspects
    table, kept = engine.table, engine.kept
    poses = np.full((engine.store.n_iterations, 4, 4), np.nan)
    for part in solved[:1]:
        poses[part.iterations] = part.poses
    static = ~table.dynamic
    static[suspects] = False
    static &= n_kept(engine) >= engine.config.group_after
    rests = at_rest(table.now(kept.landmark), placed_observations(kept, poses), static)
    return suspects[~rests[suspects]]


def _place(engine: RelativeMapper, solved: list[Solved]) -> Ints:
    """Make each part a submap; return their numbers (p,).

    Landmarks of several parts belong to the first; a part without others gets `NONE`.
    """
    table, seen = engine.table, n_kept(engine)
    table.take_off_map(np.flatnonzero(table.submap != NONE))
    drift = 1.0 if engine.odometry is None else engine.odometry.drift
    numbers, engine.refined = np.full(len(solved), NONE), []
    for k, part in enumerate(solved):
        refined = part.refined.only(table.submap[part.refined.landmarks] == NONE)
        own = refined.landmarks
        if not len(own):
            continue
        numbers[k] = engine.map.new_submap()
        engine.map.place(int(numbers[k]), own, refined.positions, seen[own])
        table.highest_level[own] = np.maximum(table.highest_level[own], 1)
        engine.refined.append(replace(refined, spread=refined.spread.scaled(drift)))
    return numbers


def _in_use(
    use: OdometryUse, solved: list[Solved], numbers: Ints, hanging: Ints, n_iterations: int
) -> OdometryUse:
    """Return how odometry is used in a map of solved parts, submaps of these numbers (p,)."""
    poses, submap = np.full((n_iterations, 4, 4), np.nan), np.full(n_iterations, NONE)
    for part, number in zip(solved, numbers, strict=True):
        poses[part.iterations], submap[part.iterations] = part.poses, number
    sigmas = np.array(solved[0].sigmas) if solved else np.ones(3)
    doubted = np.concatenate([use.left_out, *(part.doubted for part in solved)])
    return replace(
        use,
        is_used=True,
        left_out=np.unique(doubted),
        hanging=hanging,
        poses=poses,
        submap=submap,
        sigmas=sigmas,
    )
