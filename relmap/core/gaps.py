"""What odometry adds to the map: it bridges the gaps that landmarks leave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from relmap.core.association.sightings import rows_of_tracks
from relmap.core.mapper import RelativeMapper
from relmap.core.odometry import OdometryUse
from relmap.core.refinement.bridging import bridge, measured_motions, noise_of
from relmap.core.refinement.chained import Sigmas
from relmap.core.refinement.chaining import Solved, solve_part
from relmap.core.state.table import NONE

AGAIN = 2
"""Observations of a landmark that tell something of the others."""


def is_bridged(engine: RelativeMapper) -> bool:
    """Tell whether the map rests on odometry where landmarks leave gaps."""
    return engine.odometry is not None and engine.odometry.is_used


def bridge_gaps(engine: RelativeMapper, to_the_last: bool = False) -> bool:
    """Put what odometry ties in one frame, where all that was seen agrees best with it.

    Tells whether there was anything to do: where landmarks tie every scan, odometry adds nothing.
    """
    if not len(engine.motions):
        return False
    rows = engine.rows
    if not engine.association.has_ids:
        rows = rows_of_tracks(rows, engine.table)
    odometry = engine.motions.over(engine.store.n_iterations)
    measured = measured_motions(odometry, rows)
    noise, slipped = noise_of(odometry, measured, rows)
    use = OdometryUse.of(noise, slipped)
    if noise.is_wrong or not len(engine.kept):
        engine.odometry = use
        return False
    believed = noise.corrected(odometry)
    believed[slipped] = np.nan
    bridged = bridge(engine.table, rows, np.where(slipped[:, None, None], measured, believed))
    before = engine.odometry
    hanging, sigmas = bridged.hanging, None
    if before is not None and before.is_used:
        hanging, sigmas = before.hanging, Sigmas(*before.sigmas.tolist())
    if not len(hanging):
        engine.odometry = use
        return False
    mature = to_the_last and not engine.association.has_ids
    fewest = engine.config.group_after if mature else AGAIN
    roots = None
    if len(engine.weighed):
        roots = np.linalg.inv(np.linalg.cholesky(engine.weighed.covariance))
    found = [
        solve_part(
            engine.table,
            rows,
            engine.kept,
            roots,
            bridged,
            part,
            believed,
            noise,
            engine.averaging.noise.sigma_m,
            sigmas,
            to_the_last,
            fewest,
        )
        for part in range(int(bridged.part.max()) + 1)
    ]
    solved = [part for part in found if part is not None]
    _place(engine, solved)
    engine.odometry = _told(use, solved, hanging, engine.store.n_iterations)
    return True


def _place(engine: RelativeMapper, solved: list[Solved]) -> None:
    """Put the landmarks of each part in a submap of its own."""
    table = engine.table
    seen = np.bincount(table.now(engine.kept.landmark), minlength=len(table)).astype(np.float64)
    table.take_off_map(np.flatnonzero(table.submap != NONE))
    for part in solved:
        refined = part.refined
        own = refined.landmarks
        engine.map.place(engine.map.new_submap(), own, refined.positions, seen[own])
        table.highest_level[own] = np.maximum(table.highest_level[own], 1)
    engine.refined = [part.refined for part in solved]


def _told(
    use: OdometryUse, solved: list[Solved], hanging: NDArray[np.int64], n_iterations: int
) -> OdometryUse:
    poses, sigmas = np.full((n_iterations, 4, 4), np.nan), np.ones(3)
    largest = max(solved, key=lambda part: len(part.refined.landmarks), default=None)
    if largest is not None:
        poses[largest.iterations] = largest.poses
        sigmas = np.array(largest.sigmas)
    doubted = np.concatenate([use.left_out, *(part.doubted for part in solved)])
    return replace(
        use, is_used=True, left_out=np.unique(doubted), hanging=hanging, poses=poses, sigmas=sigmas
    )
