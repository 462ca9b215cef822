"""Runs of points of which odometry connects a part: what is the map, and what belongs to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from relmap import PointMapper
from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.geometry.alignment import fit_rigid

SIGMA_M, RANGE_M = 0.05, 9.0


class Drive(NamedTuple):
    """Scans along the x axis, the ids in each, and odometry (k, 3)."""

    points: list[Floats]
    ids: list[Ints]
    odometry: Floats


def drive(x: Floats, landmarks: Floats, seed: int, y: float = 0.0) -> Drive:
    rng, points, ids = np.random.default_rng(seed), [], []
    for at in x:
        local = landmarks - [at, y]
        there = np.linalg.norm(local, axis=1) < RANGE_M
        own = np.flatnonzero(there & (rng.random(len(landmarks)) > 0.05))
        points.append(local[own] + SIGMA_M * rng.normal(size=(len(own), 2)))
        ids.append(own)
    steps = np.column_stack([np.diff(x, prepend=x[0]), np.zeros((len(x), 2))])
    steps[:, 0] *= 1 + 0.02 * rng.normal(size=len(x))
    steps[:, 2] = np.deg2rad(0.3) * rng.normal(size=len(x))
    steps[0] = np.nan
    return Drive(points, ids, steps)


def feed(
    mapper: PointMapper,
    run: Drive,
    known: bool,
    given: Bools,
    covariances: float = 0.0,
    refine: bool = True,
) -> None:
    """Map a drive, with odometry (k,) where it is given, and so many times the true covariances."""
    for k, points in enumerate(run.points):
        mapper.update(
            points,
            ids=run.ids[k] if known else None,
            covariances=np.tile(covariances * SIGMA_M**2 * np.eye(2), (len(points), 1, 1))
            if covariances
            else None,
            odometry=run.odometry[k] if given[k] else None,
        )
    mapper.finish()
    if refine:
        mapper.refine()


def field(n: int, begin: float, end: float, seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(begin, end, n), rng.uniform(-8, 8, n)])


def worst_m(mapper: PointMapper, landmarks: Floats) -> float:
    found, true = mapper.map.positions[:, :2], landmarks[mapper.map.landmark_ids]
    R, t = fit_rigid(found, true)
    return float(np.linalg.norm(found @ R.T + t - true, axis=1).max())


ROAD = np.concatenate([field(90, -8, 82, 0), field(14, 110, 130, 1)])
"""Landmarks along a road; only odometry connects the last ones."""


@pytest.mark.parametrize("covariances", [0.0, 1.0])
def test_landmarks_seen_only_before_the_first_odometry_are_mapped(covariances: float) -> None:
    x = np.arange(0, 126, 0.5)
    run, later = drive(x, ROAD, 2), np.arange(len(x)) >= 150
    mapper, whole = PointMapper(), PointMapper()
    feed(mapper, run, True, later, covariances)
    feed(whole, run, True, np.ones(len(x), dtype=bool), covariances)
    assert_array_equal(mapper.map.landmark_ids, whole.map.landmark_ids)
    assert np.isfinite(mapper.trajectory[:, 0, 3]).all()
    assert worst_m(mapper, ROAD) < 3 * np.sqrt(mapper.map.covariances[:, :2, :2].max())
    assert mapper.refined[0].noise_m == pytest.approx(SIGMA_M, rel=0.15)
    own, other = mapper.trajectory[:, :2, 3], whole.trajectory[:, :2, 3]
    assert np.linalg.norm(own - other, axis=1)[:150].max() < 0.2


def test_a_common_factor_of_covariances_changes_nothing_with_odometry() -> None:
    x = np.arange(0, 126, 0.5)
    run, given, maps = drive(x, ROAD, 2), np.ones(len(x), dtype=bool), []
    for factor in (1.0, 0.01, 100.0):
        mapper = PointMapper()
        feed(mapper, run, False, given, factor)
        assert mapper.odometry.is_used
        assert mapper.refined[0].noise_m == pytest.approx(SIGMA_M, rel=0.15)
        maps.append(mapper.map)
    for other in maps[1:]:
        assert_array_equal(other.landmark_ids, maps[0].landmark_ids)
        assert_allclose(other.positions, maps[0].positions, atol=1e-6)
        assert_allclose(other.covariances, maps[0].covariances, rtol=1e-3)


def test_one_huge_covariance_is_not_the_noise_of_the_map() -> None:
    x, mapper = np.arange(0, 126, 0.5), PointMapper()
    run = drive(x, ROAD, 2)
    for k, points in enumerate(run.points):
        noise = np.tile(SIGMA_M**2 * np.eye(2), (len(points), 1, 1))
        noise[: k == 20] *= 1e8
        mapper.update(points, covariances=noise, odometry=run.odometry[k])
    mapper.finish()
    mapper.refine()
    assert mapper.odometry.is_used
    assert mapper.refined[0].noise_m == pytest.approx(SIGMA_M, rel=0.15)


@pytest.mark.parametrize("known", [True, False])
def test_a_log_with_odometry_is_added_to_a_map_without(known: bool) -> None:
    first, second = (
        drive(np.arange(0, 75, 0.5), ROAD, 3),
        drive(np.arange(40, 126, 0.5), ROAD, 4, 1.0),
    )
    mapper = PointMapper()
    feed(mapper, first, known, np.zeros(len(first.points), dtype=bool))
    before = mapper.map
    mapper.take_up(second.points[0])
    feed(mapper, second, known, np.ones(len(second.points), dtype=bool))
    now, after = mapper.landmarks_of(before.landmark_ids), mapper.map
    assert mapper.odometry.is_used
    own = np.isin(now, after.landmark_ids)
    often = mapper.landmarks.observations[np.isin(mapper.landmarks.landmark, now)] >= 10
    assert own.sum() >= (len(now) if known else often.sum())
    at = after.positions[np.searchsorted(after.landmark_ids, now[own])]
    assert np.linalg.norm(at - before.positions[own], axis=1).max() < 0.5
    start = mapper.trajectory[len(first.points)]
    assert np.linalg.norm(start[:2, 3] - [40.0, 1.0]) < 0.5
    assert np.isfinite(mapper.trajectory[:, 0, 3]).all()


def two_fields(n_first: int, n_second: int) -> tuple[Drive, Floats, int]:
    """Return a drive through two fields, the scans in the first, and the landmarks of both."""
    landmarks = np.concatenate([field(n_first, -5, 45, 5), field(n_second, 995, 1045, 6)])
    x = np.concatenate([np.arange(0, 40, 0.25), np.arange(1000, 1040, 0.5)])
    run = drive(x, landmarks, 7)
    run.odometry[160] = np.nan
    return run, landmarks, 160


def assert_same_part(mapper: PointMapper, in_first: bool, end: int) -> None:
    """Check that map, trajectory and refinement are those of one field."""
    known = np.flatnonzero(np.isfinite(mapper.trajectory[:, 0, 3]))
    assert len(known)
    assert ((known < end) == in_first).all()
    members = np.isin(mapper.landmarks.landmark, mapper.map.landmark_ids)
    assert ((mapper.landmarks.first_iteration[members] < end) == in_first).all()
    assert_array_equal(mapper.submaps[0].landmark_ids, mapper.map.landmark_ids)
    for number, (scans, poses) in enumerate(mapper.paths):
        assert ((scans < end) == (in_first == (number == 0))).all()
        assert len(scans) > 70
        if number == 0:
            assert_array_equal(scans, known)
            assert_array_equal(poses, mapper.trajectory[known])
    for refined, submap in zip(mapper.refined, mapper.submaps, strict=True):
        assert len(refined.landmarks) == len(submap.landmark_ids)
    assert mapper.refined[0].anchor_iteration in known


@pytest.mark.parametrize(("n_second", "in_first"), [(13, True), (12, True), (16, False)])
def test_map_and_trajectory_are_of_the_same_part(n_second: int, in_first: bool) -> None:
    run, _, end = two_fields(13, n_second)
    mapper = PointMapper()
    feed(mapper, run, True, np.ones(len(run.points), dtype=bool))
    assert len(mapper.submaps) == 2
    assert_same_part(mapper, in_first, end)


@pytest.mark.parametrize("known", [True, False])
def test_map_and_trajectory_are_of_the_same_part_with_another_log(known: bool) -> None:
    run, landmarks, end = two_fields(12, 22)  # The first has fewer landmarks and more scans.
    mapper = PointMapper()
    feed(mapper, run, known, np.ones(len(run.points), dtype=bool))
    assert_same_part(mapper, False, end)
    before = mapper.map
    again = drive(np.arange(1010, 1030, 0.25), landmarks, 8, 1.0)
    mapper.take_up(again.points[0])
    feed(mapper, again, known, np.ones(len(again.points), dtype=bool))
    assert_same_part(mapper, False, end)
    assert np.isfinite(mapper.trajectory[len(run.points) :, 0, 3]).all()
    now = mapper.landmarks_of(before.landmark_ids)
    assert np.isin(now, mapper.map.landmark_ids).all()


def test_the_map_is_still_one_part_after_rare_landmarks_are_left_out() -> None:
    run, landmarks, end = two_fields(12, 9)
    rare = np.arange(len(landmarks)) % 2 == 1
    rare[12:] = False
    for k, ids in enumerate(run.ids[:end]):
        seen = ~rare[ids] | (np.abs(landmarks[ids, 0] - 0.25 * k) < 0.8)
        run.points[k], run.ids[k] = run.points[k][seen], ids[seen]
    mapper = PointMapper()
    feed(mapper, run, False, np.ones(len(run.points), dtype=bool), refine=False)
    known = np.flatnonzero(np.isfinite(mapper.trajectory[:, 0, 3]))
    members = np.isin(mapper.landmarks.landmark, mapper.map.landmark_ids)
    assert (known >= end).all() == (mapper.landmarks.first_iteration[members] >= end).all()
    assert len(known)
    assert len(mapper.refined) == len(mapper.submaps)
    for refined, submap in zip(mapper.refined, mapper.submaps, strict=True):
        assert refined.landmarks.tolist() == submap.landmark_ids.tolist()


def test_parts_whose_landmarks_are_all_in_the_map_are_left_out() -> None:
    t = np.linspace(0, 4 * np.pi, 300)
    rng = np.random.default_rng(9)
    landmarks = rng.uniform(-45, 45, (60, 2))
    xy, yaw = np.column_stack([30 * np.cos(t), 20 * np.sin(t)]), t + np.pi / 2
    missing, mapper = rng.random(len(t)) < 0.3, PointMapper()
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    for k in range(len(t)):
        local = (landmarks - xy[k]) @ R[k]
        own = np.flatnonzero(np.linalg.norm(local, axis=1) < 12)
        motion = np.full(3, np.nan)
        if k and not missing[k]:
            motion = np.array([*((xy[k] - xy[k - 1]) @ R[k - 1]), yaw[k] - yaw[k - 1]])
        points = local[own] + SIGMA_M * rng.normal(size=(len(own), 2))
        mapper.update(points, ids=own, odometry=motion)
    mapper.finish()
    mapper.refine()
    assert len(mapper.refined) == len(mapper.submaps)
    assert len(mapper.refined[0].landmarks) == len(mapper.map.landmark_ids)
    assert np.isfinite(mapper.trajectory[mapper.refined[0].anchor_iteration]).all()
    assert len(mapper.refined[0].segments.residual) > 10
    assert (np.diff(np.sort(np.concatenate([r.landmarks for r in mapper.refined]))) > 0).all()


@pytest.mark.parametrize(("with_odometry", "refine"), [(False, True), (True, True), (True, False)])
def test_the_frame_stays_when_a_log_joins_an_earlier_part(
    with_odometry: bool, refine: bool
) -> None:
    landmarks = np.concatenate(
        [field(30, -5, 35, 9), field(20, 35, 50, 10), field(80, 50, 105, 11)]
    )
    if with_odometry:  # Nothing else leads from one part to the other.
        landmarks = landmarks[(landmarks[:, 0] < 30) | (landmarks[:, 0] > 50)]
    first = drive(np.concatenate([np.arange(0, 20, 0.5), np.arange(62, 100, 0.5)]), landmarks, 12)
    mapper = PointMapper()
    feed(mapper, first, True, np.zeros(len(first.points), dtype=bool), refine=refine)
    assert len(mapper.submaps) == 2
    before, second = mapper.map, drive(np.arange(8, 80, 0.5), landmarks, 13, 1.0)
    mapper.take_up(second.points[-1])
    feed(mapper, second, True, np.full(len(second.points), with_odometry))
    assert len(mapper.submaps) == 1
    own = np.isin(mapper.map.landmark_ids, before.landmark_ids)
    assert own.sum() == len(before.landmark_ids)
    off_m = np.linalg.norm(mapper.map.positions[own] - before.positions, axis=1)
    assert np.median(off_m) < 0.2
