"""Maps among many moving landmarks, without ids: how wrong submaps are, and when that is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap import PointMapper
from relmap.cli.warned import OUTLYING
from relmap.core.geometry.alignment import fit_rigid
from relmap.evaluation.metrics import majority_ids
from relmap.evaluation.run import run_mapper
from relmap.simulation import simulate_figure_eight


@pytest.mark.parametrize(
    ("dynamic", "seed", "off_m"), [(0.5, 1, 0.05), (0.65, 4, 0.4), (0.7, 3, 0.4)]
)
def test_the_submaps_among_moving_landmarks_are_right(
    dynamic: float, seed: int, off_m: float
) -> None:
    """Static landmarks of each submap with ten of them: RMSE after alignment below `off_m`.

    These submaps hold at least half as many as are static, and all submaps 30 % of all landmarks.
    """
    world, mapper = simulate_figure_eight(dynamic=dynamic, seed=seed), PointMapper()
    labels = np.concatenate([mapper.update(scan.points_robot) for scan in world.log.scans()])
    mapper.finish()
    mapper.refine()
    ids = np.concatenate([scan.ids for scan in world.log.scans()])
    found, true_ids, _ = majority_ids(mapper.landmarks_of(labels), ids)
    stands_for = dict(zip(found.tolist(), true_ids.tolist(), strict=True))
    assert sum(len(submap.landmark_ids) for submap in mapper.submaps) >= 0.3 * len(world.status)
    n_judged = 0
    for submap in mapper.submaps:
        own = np.array([stands_for[label] for label in submap.landmark_ids.tolist()])
        still = world.status[own] == "static"
        if still.sum() < 10:
            continue
        n_judged += still.sum()
        here, there = submap.positions[still], world.landmarks_map[own[still]]
        R, t = fit_rigid(here, there)
        assert np.sqrt(np.mean(np.sum((here @ R.T + t - there) ** 2, axis=1))) < off_m
    assert n_judged >= 0.5 * (world.status == "static").sum()


@pytest.mark.parametrize(("step_m", "is_right"), [(0.0, True), (0.02, False)])
def test_observations_contradict_the_map_where_many_move_slowly_together(
    step_m: float, is_right: bool
) -> None:
    """If a third moves, their share passes the limit of the warning; if none does, it does not."""
    world = simulate_figure_eight(seed=1)
    log, moving = world.log, world.landmark_ids % 3 == 0
    ahead = world.trajectory[log.iteration, 0, :3]  # the x axis of the map, robot frame
    shift = step_m * (log.iteration * moving[log.ids])[:, None] * ahead
    log = replace(log, points_robot=log.points_robot + shift)
    summary = run_mapper(PointMapper(), log, "nearest", refine=True).result.summary
    contradicting = summary["association_trust"]["contradicting"]
    assert (contradicting <= OUTLYING) == is_right
