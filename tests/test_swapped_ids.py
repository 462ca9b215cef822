"""Points with odometry and ids that are swapped for a while."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap.cli.outcome import on_odometry
from relmap.core.arrays import Ints
from relmap.core.refinement.chain.chain_data import Chain
from relmap.core.refinement.chain.visits import visits_of
from relmap.core.state.table import NONE
from relmap.datasets import ObservationLog
from relmap.evaluation.run import map_log
from tests.test_odometry_ids import NOISE_M, SCANS, landmarks, rounds
from tests.worlds import aligned_rmse


def swapped(log: ObservationLog, one: int, other: int, begin: int) -> Ints:
    """Return the ids of a log, two of them swapped for a fifth of its scans."""
    there = (log.iteration >= begin) & (log.iteration < begin + SCANS // 5)
    ids = np.where(there & (log.ids == one), other, log.ids)
    return np.where(there & (log.ids == other), one, ids)


@pytest.mark.parametrize(
    ("most", "one", "other", "begin"), [(1, 68, 0, 194), (2, 24, 10, 270), (2, 43, 38, 267)]
)
def test_swapped_ids_neither_fold_the_map_nor_are_mapped(
    most: int, one: int, other: int, begin: int
) -> None:
    """A landmark was 27 m off, and two maps 7 and 8 m."""
    log = rounds(most)
    ids = swapped(log, one, other, begin)
    result = map_log(replace(log, ids=ids), association="known").result
    table, mapped = result.landmarks, result.mapped
    assert np.sum(mapped) >= 30
    truth = landmarks()[table.landmark[mapped]]
    assert aligned_rmse(table.position[mapped, :2], truth) < 0.1
    odometry = result.summary["odometry"]
    assert odometry["of_two_places"]["count"] > 0
    assert set(odometry["of_two_places"]["ids"]) <= {one, other}
    assert "observations of their id show two places: " in on_odometry(odometry)


@pytest.mark.parametrize("most", [1, 2])
def test_right_ids_name_one_place(most: int) -> None:
    odometry = map_log(rounds(most), association="known").result.summary["odometry"]
    assert odometry["of_two_places"] == {"count": 0, "ids": []}
    assert "two places" not in on_odometry(odometry)


def test_a_place_nearer_than_another_landmark_is_not_one_of_two() -> None:
    """For thirty scans ranges are 0.8 m too long: where the map bends, a landmark was left out."""
    log = rounds(3)
    long = np.where((log.iteration >= 300) & (log.iteration < 330), 0.8, 0.0)
    range_m = np.linalg.norm(log.points_robot, axis=1)
    points = log.points_robot * (1 + long / range_m)[:, None]
    result = map_log(replace(log, points_robot=points), association="known").result
    assert result.summary["odometry"]["of_two_places"] == {"count": 0, "ids": []}
    truth = landmarks()[result.landmarks.landmark[result.mapped]]
    assert aligned_rmse(result.landmarks.position[result.mapped, :2], truth) < 0.1
    assert len(truth) == len(np.unique(log.ids))


def test_visits_whose_distances_to_others_differ_have_swapped_ids() -> None:
    """A robot at rest sees nine landmarks three times, two swapped the second time, one far off."""
    rng, n = np.random.default_rng(0), 9
    times = np.concatenate([np.arange(10) + 20 * k for k in range(3)])
    true, of = rng.uniform(-8, 8, (n, 2)), np.tile(np.arange(n), len(times))
    scan = np.append(np.repeat(times, n), times[-1])
    points = np.append(true[of] + rng.normal(0, NOISE_M, (len(of), 2)), [[30.0, 9.0]], axis=0)
    is_wrong = (scan >= 20) & (scan < 30) & (np.append(of, 0) < 2)
    ids = np.append(of, 0)
    ids = np.where(is_wrong, 1 - ids, ids)
    root = np.tile(np.eye(2) / NOISE_M, (len(ids), 1, 1))
    chain = Chain(points, ids, scan, root, np.tile(np.eye(4), (times[-1], 1, 1)))
    sd = np.full(times[-1], 0.01), np.full(times[-1], 0.001)
    visit, is_swapped = visits_of(chain, sd)
    assert np.array_equal(is_swapped, is_wrong)
    assert np.flatnonzero(visit == NONE).tolist() == [len(of)]
    assert len(np.unique(visit[:-1])) == 3 * n
