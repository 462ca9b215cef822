"""Points with odometry: its faults are noticed, and it is left out there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from relmap import PointMapper
from tests.odometry_runs import (
    DENSE,
    SPARSE,
    Array,
    mapped,
    odometry_of,
    rmse_m,
    world,
)


def test_reversed_odometry_is_noticed_and_left_out() -> None:
    run = world(DENSE, 120)
    backwards: Array = np.asarray(np.linalg.inv(odometry_of(run, 0)))
    mapper, labels = mapped(run, backwards, known=False)
    without, same = mapped(run, None, known=False)
    assert mapper.odometry.noise.is_wrong
    assert_array_equal(labels, same)
    assert_array_equal(mapper.map.positions, without.map.positions)


def test_odometry_stuck_at_zero_is_noticed_and_left_out() -> None:
    run = world(SPARSE, 250)
    mapper, _ = mapped(run, np.tile(np.eye(4), (250, 1, 1)), known=False)
    without, _ = mapped(run, None, known=False)
    assert mapper.odometry.noise.is_wrong
    assert not mapper.odometry.is_used
    assert_allclose(mapper.map.positions, without.map.positions, atol=1e-6)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("fault", ["mirrored", "degrees"])
def test_turns_that_are_mirrored_or_in_degrees_are_noticed_where_few_steps_turn(
    fault: str, known: bool
) -> None:
    """Along straights with two bends, and a gap: the map was metres off, with a standard deviation
    of a tenth of that."""
    turn = np.zeros(160)
    turn[[*range(40, 52), *range(110, 122)]] = np.deg2rad(7)
    rng, yaw = np.random.default_rng(5), np.cumsum(turn)
    way = 0.6 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    at = np.cumsum(way, axis=0)
    landmarks = at[rng.integers(0, len(at), 70)] + rng.uniform(-8, 8, (70, 2))
    factor = -1.0 if fault == "mirrored" else np.rad2deg(1.0)
    mapper = PointMapper()
    for k in range(len(at)):
        c, s = np.cos(yaw[k]), np.sin(yaw[k])
        points = (landmarks - at[k]) @ np.array([[c, -s], [s, c]])
        seen = np.flatnonzero((np.hypot(*points.T) < 9) & (not 80 <= k < 92))
        points = points[seen] + rng.normal(0, 0.03, (len(seen), 2))
        noise = rng.normal(0, [0.02, 0.02, np.deg2rad(0.1)])
        motion = np.array([0.6 * np.cos(turn[k]), 0.6 * np.sin(turn[k]), turn[k]]) + noise
        motion *= [1.0, np.sign(factor), factor]
        mapper.update(points, ids=seen if known else None, odometry=motion if k else None)
    mapper.finish()
    mapper.refine()
    assert mapper.odometry.noise.is_wrong
    assert not mapper.odometry.is_used


@pytest.mark.parametrize("stuck", [slice(1, 83), slice(167, 250)])
def test_a_stretch_of_odometry_stuck_at_zero_is_left_out(stuck: slice) -> None:
    run = world(2 * SPARSE, 250)
    motions = odometry_of(run, 0)
    motions[stuck] = np.eye(4)
    mapper, labels = mapped(run, motions, known=False)
    now, true = mapper.landmarks_of(labels), run.log.ids
    of = [np.bincount(true[now == landmark]).argmax() for landmark in mapper.map.landmark_ids]
    assert mapper.odometry.is_used
    assert len(set(mapper.odometry.left_out) & set(range(250)[stuck])) > 0.9 * 82
    assert rmse_m(run, mapper.map.positions, np.array(of)) < 0.1


def test_a_leap_of_odometry_in_a_gap_is_left_out() -> None:
    run, gap = world(2 * SPARSE, 250), 125
    motions = odometry_of(run, 0)
    motions[gap, 0, 3] += 60.0
    mapper, labels = mapped(run, motions, known=False)
    now, true = mapper.landmarks_of(labels), run.log.ids
    of = [np.bincount(true[now == landmark]).argmax() for landmark in mapper.map.landmark_ids]
    assert gap in mapper.odometry.hanging
    assert mapper.odometry.left_out.tolist() == [gap]
    assert rmse_m(run, mapper.map.positions, np.array(of)) < 0.1


def test_odometry_into_the_first_scan_is_neither_used_nor_rejected() -> None:
    run = world(2 * SPARSE, 100)
    motions, mappers = odometry_of(run, 0), [PointMapper(), PointMapper()]
    for mapper, far_m in zip(mappers, (np.nan, 60.0), strict=True):
        motions[0] = np.eye(4) if far_m > 0 else np.nan
        motions[0, 0, 3] = far_m
        for k, scan in enumerate(run.log.scans()):
            mapper.update(scan.points_robot, odometry=motions[k])
        mapper.finish()
    unknown, leap = mappers
    assert_array_equal(leap.map.positions, unknown.map.positions)
    assert leap.odometry.left_out.tolist() == unknown.odometry.left_out.tolist() == []


def test_slips_are_named_where_landmarks_show_them() -> None:
    run = world(DENSE, 200)
    motions = odometry_of(run, 0)
    slips = np.flatnonzero(np.random.default_rng(2).random(len(motions)) < 0.1)
    motions[slips, :3, 3] *= 2
    mapper, _ = mapped(run, motions, known=False)
    assert not mapper.odometry.noise.is_wrong
    assert set(mapper.odometry.left_out) <= set(slips)
    assert len(mapper.odometry.left_out) >= 0.7 * len(slips)
