"""Points with odometry: sparse landmarks in one frame, several logs, and noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from relmap import PointMapper
from relmap.simulation.figure_eight import simulate_figure_eight
from tests.odometry_runs import (
    DENSE,
    SPARSE,
    finished,
    mapped,
    odometry_of,
    rmse_m,
    world,
)


def test_sparse_landmarks_with_ids_are_one_map_with_odometry_and_several_without() -> None:
    run = world(SPARSE, 250)
    mapper, _ = mapped(run, odometry_of(run, 0), known=True)
    often = np.bincount(run.log.ids) >= 2
    assert len(mapper.submaps) == 1
    assert_array_equal(mapper.map.landmark_ids, np.flatnonzero(often))
    assert rmse_m(run, mapper.map.positions, mapper.map.landmark_ids) < 0.3
    assert np.isfinite(mapper.trajectory).all()
    assert mapper.odometry.is_used
    assert len(mapper.odometry.hanging) > 0
    without, _ = mapped(run, None, known=True)
    assert len(without.map.landmark_ids) < len(mapper.map.landmark_ids)
    assert without.odometry is None


def test_sparse_landmarks_without_ids_are_distinguished_with_odometry() -> None:
    run = world(SPARSE, 250)
    mapper, labels = mapped(run, odometry_of(run, 0), known=False)
    now, true = mapper.landmarks_of(labels), run.log.ids
    own = mapper.map.landmark_ids
    of = np.array([np.bincount(true[now == landmark]).argmax() for landmark in own])
    pure = [np.mean(true[now == landmark] == name) for landmark, name in zip(own, of, strict=True)]
    assert len(mapper.submaps) == 1
    assert min(pure) == 1
    assert len(own) <= 1.15 * len(set(of.tolist()))
    assert set(np.flatnonzero(np.bincount(true) >= 10)) <= set(of.tolist())
    assert rmse_m(run, mapper.map.positions, of) < 0.3


def test_a_single_landmark_is_followed_by_odometry_from_the_first_scan_on() -> None:
    mapper = PointMapper()
    labels = [
        mapper.update([[5.0 - k, 1.0]], odometry=[1.0, 0.0, 0.0] if k else None).item()
        for k in range(5)
    ]
    assert set(labels) == {labels[0]}


@pytest.mark.parametrize("d", [2, 3])
def test_single_landmarks_far_apart_are_not_one_because_no_spacing_is_known(d: int) -> None:
    rng, mapper, labels = np.random.default_rng(0), PointMapper(), list[int]()
    landmarks, of = 10.0 * np.eye(d)[:2], [0, 0, 1, 1, 0, 1, 0, 0, 1]
    for which in of:
        seen = landmarks[[which]] + 0.02 * rng.normal(size=(1, d))
        labels += mapper.update(seen, odometry=np.eye(4)).tolist()
    assert labels == of


def test_single_landmarks_close_a_loop_if_no_others_might_be_meant() -> None:
    run = simulate_figure_eight(density=SPARSE, seed=2)
    mapper, labels = finished(run, odometry_of(run, 2), known=False)
    true = run.log.ids
    for _ in range(2):  # The map is solved again after merging, with and without refinement.
        now = mapper.landmarks_of(labels)
        of = [np.bincount(true[now == landmark]).argmax() for landmark in mapper.map.landmark_ids]
        assert sorted(of) == run.landmark_ids.tolist()
        assert rmse_m(run, mapper.map.positions, np.array(of)) < 0.1
        mapper.refine()


def test_if_landmarks_link_every_scan_odometry_changes_nothing() -> None:
    run = world(DENSE, 120)
    with_it, labels = mapped(run, odometry_of(run, 0), known=False)
    without, same = mapped(run, None, known=False)
    assert_array_equal(labels, same)
    assert_array_equal(with_it.map.positions, without.map.positions)
    assert not with_it.odometry.is_used


def test_a_gap_without_odometry_leaves_two_submaps() -> None:
    run = world(SPARSE, 400)
    motions = odometry_of(run, 0)
    motions[200] = np.nan
    mapper, _ = mapped(run, motions, known=False)
    assert mapper.odometry is not None
    assert len(mapper.submaps) <= 2
    largest = max(len(submap.landmark_ids) for submap in mapper.submaps)
    assert largest == len(mapper.map.landmark_ids)


@pytest.mark.parametrize("known", [True, False])
def test_a_resumed_run_with_odometry_is_the_same(tmp_path: Path, known: bool) -> None:
    run = world(SPARSE, 120)
    journal = tmp_path / "journal.sqlite"
    mapper, _ = mapped(run, odometry_of(run, 0), known, journal)
    mapper.close()
    again = PointMapper.resume(journal)
    again.finish()
    again.refine()
    assert_array_equal(again.map.positions, mapper.map.positions)
    assert_array_equal(again.trajectory, mapper.trajectory)
    again.save(tmp_path / "mapper.npz")
    loaded = PointMapper.load(tmp_path / "mapper.npz")
    assert_array_equal(loaded.trajectory, mapper.trajectory)
    assert loaded.odometry.is_used
    again.close()


def test_two_runs_in_one_log_are_one_map_where_ids_say_what_is_the_same() -> None:
    run = world(SPARSE, 150)
    motions = odometry_of(run, 0)
    mapper = PointMapper()
    for turn in range(2):
        for k, scan in enumerate(run.log.scans()):
            first = k == 0
            motion = np.full((4, 4), np.nan) if first else motions[k]
            mapper.update(scan.points_robot, ids=scan.ids, odometry=motion)
        assert mapper.n_iterations == 150 * (turn + 1)
    mapper.finish()
    mapper.refine()
    assert len(mapper.submaps) == 1
    assert rmse_m(run, mapper.map.positions, mapper.map.landmark_ids) < 0.3
    assert np.isfinite(mapper.trajectory).all()


def test_a_map_stays_the_first_submap_beside_a_longer_log_that_is_not_connected() -> None:
    run = world(SPARSE, 150)
    motions, mapper = odometry_of(run, 0), PointMapper()
    for count, first_id in ((80, 0), (150, 1000)):
        for scan in run.log.between(0, count).scans():
            if first_id and not scan.iteration:
                mapper.take_up(scan.points_robot)
            motion = np.full((4, 4), np.nan) if not scan.iteration else motions[scan.iteration]
            mapper.update(scan.points_robot, ids=scan.ids + first_id, odometry=motion)
        mapper.finish()
        mapper.refine()
    assert np.flatnonzero(np.isfinite(mapper.trajectory[:, 0, 3])).tolist() == list(range(80))
    assert mapper.map.landmark_ids.max() < 1000
    assert len(mapper.submaps) == 2


def test_covariances_weigh_the_observations_that_they_came_with() -> None:
    run, rng = world(SPARSE, 150), np.random.default_rng(0)
    motions, mapper = odometry_of(run, 0), PointMapper()
    for k, scan in enumerate(run.log.scans()):
        n = len(scan.points_robot)
        sigma = np.where(rng.random(n) < 0.3, 3.0, 0.05)
        noise = sigma[:, None] * rng.normal(size=(n, 3)) * (sigma[:, None] > 1)
        mapper.update(
            scan.points_robot + noise,
            ids=scan.ids,
            covariances=sigma[:, None, None] ** 2 * np.eye(3),
            odometry=motions[k] if k else None,
        )
    mapper.finish()
    mapper.refine()
    assert len(mapper.submaps) == 1
    assert rmse_m(run, mapper.map.positions, mapper.map.landmark_ids) < 0.5


@pytest.mark.parametrize("known", [True, False])
def test_with_odometry_movers_are_dynamic_and_what_only_scatters_is_mapped(known: bool) -> None:
    run = world(SPARSE, 150)
    mapper = PointMapper()
    rng, steps = np.random.default_rng(3), np.arange(60, 90)
    middle = run.trajectory[75]
    start = middle[:3, 3] + middle[:3, :3] @ [4.0, 0.0, 0.0]
    noisy = middle[:3, 3] + middle[:3, :3] @ [4.0, 3.0, 0.0]
    motions, labels = odometry_of(run, 0), []
    for k, scan in enumerate(run.log.scans()):
        points, ids = scan.points_robot, scan.ids
        assert ids is not None
        if k in steps:
            moved = start + np.array([0.5 * (k - 75), 0.0, 0.0])
            scattered = noisy + rng.normal(0, 0.13, 3)
            back = np.linalg.inv(run.trajectory[k])
            more = np.array([moved, scattered]) @ back[:3, :3].T + back[:3, 3]
            points, ids = np.concatenate([points, more]), np.append(ids, [1000, 1001])
        label = mapper.update(points, ids=ids if known else None, odometry=motions[k])
        labels.append(label[-2:] if k in steps else label[:0])
    mapper.finish()
    mapper.refine()
    mover, scatters = mapper.landmarks_of(np.concatenate(labels)).reshape(-1, 2).T
    assert not np.isin(mapper.map.landmark_ids, mover).any()
    assert np.isin(scatters, mapper.map.landmark_ids).mean() > 0.5


def test_a_scan_that_is_taken_up_says_nothing_of_the_odometry_into_it() -> None:
    world, mapper = np.random.default_rng(0).uniform(-15.0, 15.0, (40, 2)), PointMapper()
    for k in range(30):
        labels = mapper.update(world - [k, 0.0])
    for k in range(30, 50):
        assert mapper.take_up(world - [k, 0.0])
        mapper.update(world - [k, 0.0], odometry=[1.0, 0.0, 0.0])
    # So few are matched only by odometry.
    found = mapper.update(world[:2] - [50.0, 0.0], odometry=[1.0, 0.0, 0.0])
    assert_array_equal(found, labels[:2])
