"""The figures against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.shared import judging
from relmap.core.arrays import Floats
from relmap.evaluation import metrics
from tests.tables import poses_along


def poses_at(positions: Floats, turn: Rotation | None = None) -> Floats:
    poses = poses_along(*positions.T)
    if turn is not None:
        poses[:, :3, :3] = turn.as_matrix()
    return poses


def test_rms_of_vectors() -> None:
    assert metrics.rms(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(np.sqrt(12.5))
    assert metrics.rms(np.empty((0, 3))) is None


@pytest.mark.parametrize("d", [2, 3])
def test_align_undoes_a_rigid_motion(d: int) -> None:
    rng = np.random.default_rng(0)
    source = rng.normal(size=(10, d))
    turn = Rotation.from_rotvec([0.0, 0.0, 2.0]).as_matrix()[:d, :d]
    target = source @ turn.T + np.arange(1.0, d + 1)
    R, t = metrics.align(source, target)
    np.testing.assert_allclose(R, turn, atol=1e-12)
    np.testing.assert_allclose(t, np.arange(1.0, d + 1), atol=1e-12)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_align_of_few_points_is_still_a_rigid_motion(n: int) -> None:
    source = np.arange(3.0 * n).reshape(n, 3)
    target = source + np.array([1.0, 2.0, 3.0])
    R, t = metrics.align(source, target)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(source @ R.T + t, target, atol=1e-12)


def test_majority_and_purity() -> None:
    landmark = np.array([7, 7, 7, 9, 9, 4, 5])
    true_id = np.array([1, 1, 2, 3, 2, -1, 8])
    labels, ids, agreeing = metrics.majority_ids(landmark, true_id)
    assert labels.tolist() == [5, 7, 9]
    assert ids.tolist() == [8, 1, 2]
    assert agreeing.tolist() == [1, 2, 1]
    assert metrics.purity(landmark, true_id) == pytest.approx(4 / 6)


def test_without_a_true_id_there_is_no_purity() -> None:
    landmark, true_id = np.array([1, 2]), np.array([-1, -1])
    assert metrics.purity(landmark, true_id) is None
    assert [len(column) for column in metrics.majority_ids(landmark, true_id)] == [0, 0, 0]


def test_seen_often_counts_iterations_not_observations() -> None:
    true_id = np.repeat([1, 2, -1], 12)
    iteration = np.concatenate([np.arange(12), np.arange(12) // 2, np.arange(12)])
    assert metrics.seen_often(true_id, iteration).tolist() == [1]
    assert metrics.seen_often(true_id, iteration, 6).tolist() == [1, 2]


def test_stamps_match_the_nearest_within_the_tolerance() -> None:
    stamps_s = np.array([0.0, 1.0, 2.004, 3.0, 4.02])
    others_s = np.array([4.0, 3.001, 2.0, 2.008, 0.003])
    mine, other = metrics.match_stamps(stamps_s, others_s)
    assert mine.tolist() == [0, 2, 3]
    assert others_s[other].tolist() in ([0.003, 2.0, 3.001], [0.003, 2.008, 3.001])


def test_no_stamp_is_given_twice() -> None:
    mine, other = metrics.match_stamps(np.array([0.0, 0.004, 0.006]), np.array([0.005]))
    assert len(mine) == len(other) == 1
    assert mine[0] in (1, 2)


@pytest.mark.parametrize(("n", "m"), [(0, 3), (3, 0), (0, 0)])
def test_no_stamps_no_matches(n: int, m: int) -> None:
    mine, other = metrics.match_stamps(np.zeros(n), np.zeros(m))
    assert len(mine) == len(other) == 0


def test_ate_of_a_square_blown_up_by_a_tenth() -> None:
    square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    # No scale is fitted: every corner is off by a tenth of its distance from the middle.
    for planar in (True, False):
        ate = metrics.ate(poses_at(1.1 * square), poses_at(square), planar)
        assert ate == pytest.approx(0.1 * np.sqrt(2))


def test_planar_ate_looks_at_the_plane_only() -> None:
    path = np.array([[0.0, 0, 5], [1, 0, 7], [1, 2, 9]])
    flat = path * [1, 1, 0]
    assert metrics.ate(poses_at(path), poses_at(flat), planar=True) == pytest.approx(0, abs=1e-12)


def test_rpe_of_a_known_shift() -> None:
    true_poses = poses_at(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]))
    poses = poses_at(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0.3, 0.4]]))
    instant = np.arange(3)
    assert metrics.rpe(poses, true_poses, instant) == pytest.approx(0.5 / np.sqrt(2))


def test_rpe_skips_gaps() -> None:
    true_poses = poses_at(np.array([[0.0, 0, 0], [1, 0, 0], [5, 0, 0]]))
    poses = poses_at(np.array([[0.0, 0, 0], [1.1, 0, 0], [9, 0, 0]]))
    assert metrics.rpe(poses, true_poses, np.array([0, 1, 5])) == pytest.approx(0.1)
    assert metrics.rpe(poses, true_poses, np.array([0, 2, 5])) is None
    assert metrics.rpe(poses[:0], true_poses[:0], np.empty(0, np.intp)) is None


def test_steps_are_wrong_by_shift_or_by_turn() -> None:
    true_poses = poses_at(np.arange(18.0).reshape(6, 3))
    shift = np.cumsum([0.0, 0.29, 0.31, 0.0, 0.0, 0.0])[:, None] * [0.6, 0.8, 0.0]
    yaw = np.deg2rad([0.0, 0.0, 0.0, 9.9, 20.1, 20.1])
    poses = poses_at(true_poses[:, :3, 3] + shift, Rotation.from_euler("z", yaw[:, None]))
    # Where the robot only turned it stays where it is: later positions turn with it.
    for k in (4, 5):
        poses[k:, :3, 3] = poses[k - 1, :3, 3] + poses[k - 1, :3, :3] @ [3.0, 3.0, 3.0]
    assert judging.wrong_steps(poses, true_poses).tolist() == [2, 4]
    assert judging.wrong_steps(poses, true_poses, most_m=1.0).tolist() == [4]
    turned = Rotation.from_rotvec([0.0, 0.0, 2.0]).as_matrix()
    other = poses.copy()
    other[:, :3] = turned @ other[:, :3]
    assert judging.wrong_steps(other, true_poses).tolist() == [2, 4]
    assert len(judging.wrong_steps(poses[:1], true_poses[:1])) == 0


def test_scans_overlap_where_the_motion_is_right() -> None:
    rng = np.random.default_rng(0)
    place = rng.uniform(-50, 50, (200, 2))  # far apart: hardly any is near another by chance
    T = poses_at(np.array([[1.0, 2.0, 0.0]]), Rotation.from_euler("z", [[0.5]]))[0]
    seen_before = place @ T[:2, :2].T + T[:2, 3]
    assert judging.overlap(place, seen_before, T) == 1.0
    assert judging.overlap(place[:100], seen_before[50:], T) == pytest.approx(0.5, abs=0.03)
    assert judging.overlap(place, seen_before, np.eye(4)) < 0.05
    assert judging.overlap(place[:0], seen_before, T) == 0.0
    assert judging.overlap(place, seen_before[:0], T) == 0.0


def test_scans_of_wrong_and_of_short_submaps_are_not_right() -> None:
    scans, ates_m = np.array([50.0, 30, 10, 9]), np.array([0.3, 0.31, 0.0, 0.0])
    assert judging.share_right(scans, ates_m, 100) == pytest.approx(0.6)
    assert judging.share_right(scans, ates_m, 100, most_m=0.4) == pytest.approx(0.9)
    assert judging.share_right(scans[:0], ates_m[:0], 100) == 0.0


@given(st.integers(0, 1000))
def test_no_error_depends_on_the_frame_of_the_map(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true_poses = poses_at(rng.normal(size=(8, 3)), Rotation.random(8, rng))
    poses = true_poses.copy()
    poses[:, :3, 3] += rng.normal(scale=0.1, size=(8, 3))
    T_other_map = poses_at(rng.normal(size=(1, 3)), Rotation.random(1, rng))[0]
    moved, instant = T_other_map @ poses, np.arange(8)
    ate = metrics.ate(poses, true_poses, planar=False)
    assert metrics.ate(moved, true_poses, planar=False) == pytest.approx(ate)
    rpe = metrics.rpe(poses, true_poses, instant)
    assert metrics.rpe(moved, true_poses, instant) == pytest.approx(rpe)
    assert metrics.ate(T_other_map @ true_poses, true_poses, False) == pytest.approx(0, abs=1e-9)
