"""The real data sets: counts that their descriptions state, and the exact truth."""

from __future__ import annotations

import gzip
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.core.geometry.alignment import fit_rigid
from relmap.datasets import open_log, slsjf, write_observation_csv
from relmap.datasets.mrpt_landmarks import read_ground_truth
from relmap.datasets.victoria_park import read_reference_map


@pytest.mark.parametrize(
    ("name", "steps", "mean", "fewest", "most", "seen", "columns", "error_m"),
    [
        ("kf-slam_demo", 250, 14.4, 3, 28, 70, 2, 0.010),
        ("kf-slam_6D_demo", 600, 9.7, 1, 22, 48, 3, 0.016),
        ("kf-slam_6D_demo_noncentered", 600, 14.3, 4, 24, 44, 3, 0.016),
    ],
)
def test_mrpt_logs_agree_with_their_truth(
    shared_data: Path,
    name: str,
    steps: int,
    mean: float,
    fewest: int,
    most: int,
    seen: int,
    columns: int,
    error_m: float,
) -> None:
    log = open_log(shared_data / "mrpt-kf-slam" / f"{name}.observations.csv.gz")
    counts = [len(scan.points_robot) for scan in log.scans()]
    assert (len(counts), min(counts), max(counts)) == (steps, fewest, most)
    assert np.mean(counts) == pytest.approx(mean, abs=0.05)
    assert log.points_robot.shape[1] == columns
    assert len(np.unique(log.ids)) == seen

    ids, positions, poses = read_ground_truth(
        shared_data / "mrpt-kf-slam" / f"{name}_ground_truth.txt"
    )
    assert len(poses) == steps
    points_robot = np.zeros((len(log.rows), 3))
    points_robot[:, :columns] = log.points_robot
    rotations, translations = poses[log.iteration, :3, :3], poses[log.iteration, :3, 3]
    points_map = np.einsum("nij,nj->ni", rotations, points_robot) + translations
    order = np.argsort(ids)
    true = positions[order][np.searchsorted(ids[order], log.ids)]
    errors = np.linalg.norm(points_map - true, axis=1)
    assert np.median(errors) == pytest.approx(error_m, abs=0.001)
    assert errors.max() < 0.1


def test_mrpt_folder_with_several_logs_is_ambiguous(shared_data: Path) -> None:
    with pytest.raises(RelmapError, match="3 MRPT landmark logs") as caught:
        open_log(shared_data / "mrpt-kf-slam")
    assert "kf-slam_6D_demo_noncentered.observations.csv.gz" in str(caught.value)


def test_victoria_park(shared_data: Path) -> None:
    log = open_log(shared_data / "victoria-park")
    counts = np.array([len(scan.points_robot) for scan in log.scans()])
    assert (len(log.rows), len(counts)) == (52974, 7249)
    assert (counts.max(), (counts == 0).sum()) == (18, 19)
    assert counts[1181:1642].mean() == pytest.approx(8.26, abs=0.005)
    assert counts[1181:1642].min() >= 4 > max(counts[1180], counts[1642])
    assert counts[4220:4634].mean() == pytest.approx(8.65, abs=0.005)
    assert log.stamps_s[[0, -1]].tolist() == pytest.approx([21.819, 1570.208])
    assert (log.points_robot[:, 0] > -1e-9).all()
    assert np.linalg.norm(log.points_robot, axis=1).max() < 75.3


def test_victoria_park_ids(shared_data: Path) -> None:
    """Every associated detection is found, once, and neighbours in time agree on its place."""
    log = open_log(shared_data / "victoria-park" / "trees_per_scan.csv.gz")
    assert (int((log.ids >= 0).sum()), len(np.unique(log.ids))) == (46860, 300)
    scans = list(log.between(1181, 1642).scans())
    moves = []
    for before, after in pairwise(scans):
        shared, i, j = np.intersect1d(before.ids, after.ids, return_indices=True)
        moves.append((after.points_robot[j] - before.points_robot[i])[shared >= 0])
    assert min(len(move) for move in moves) >= 3
    assert np.quantile(np.linalg.norm(np.vstack(moves), axis=1), 0.95) < 1.5


def test_victoria_park_reference_map_fits_the_observed_distances(shared_data: Path) -> None:
    log = open_log(shared_data / "victoria-park")
    ids, positions = read_reference_map(shared_data / "victoria-park")
    assert (len(ids), positions.shape) == (299, (299, 3))
    assert not positions[:, 2].any()
    differences = []
    for scan in log.scans():
        known = scan.ids >= 0
        points, places = scan.points_robot[known], positions[np.searchsorted(ids, scan.ids[known])]
        if len(points) > 1:
            seen = np.linalg.norm(points[1:] - points[:-1], axis=1)
            differences.append(seen - np.linalg.norm(places[1:] - places[:-1], axis=1))
    assert np.median(np.abs(np.concatenate(differences))) < 0.1


def test_slsjf_agrees_with_its_truth(shared_data: Path) -> None:
    log = open_log(shared_data / "slsjf-sim-8240")
    # 40524 rows, five of them with a negative range.
    assert (len(log), len(log.rows), int(log.rows.max())) == (8240, 40519, 40523)
    assert (log.first_iteration, len(np.unique(log.ids))) == (0, 612)
    ids, positions, poses = slsjf.read_ground_truth(shared_data / "slsjf-sim-8240")
    assert (len(ids), len(poses)) == (2500, 8241)
    R, t = poses[log.iteration, :2, :2], poses[log.iteration, :2, 3]
    points_map = np.einsum("nij,nj->ni", R, log.points_robot) + t
    assert np.array_equal(ids, np.arange(1, 2501))
    errors = np.linalg.norm(points_map - positions[log.ids - 1, :2], axis=1)
    assert np.median(errors) == pytest.approx(0.097, abs=0.001)
    assert errors.max() < 0.3


def test_dlr_circles(shared_data: Path) -> None:
    log = open_log(shared_data / "dlr-circles")
    counts = np.array([len(scan.rows) for scan in log.scans()])
    assert (len(counts), len(log.rows), counts.max()) == (3297, 14745, 13)
    assert np.mean(counts >= 4) == pytest.approx(0.696, abs=0.0005)
    # 577 different numbers, -1 among them.
    assert (len(np.unique(log.ids)), np.sum(log.ids == -1), int(log.ids.min())) == (577, 436, -1)
    assert log.points_robot[:, 0].min() > 0
    assert np.linalg.norm(log.points_robot, axis=1).max() < 4.4


def test_dlr_circles_agree_with_the_odometry(shared_data: Path) -> None:
    """The header puts -Y ahead and X to the right: the steps are (-dY, -dX), turned by -dPhi."""
    folder = shared_data / "dlr-circles"
    text = gzip.decompress((folder / "map.circles.gz").read_bytes()).decode()
    lines = [line.split() for line in text.splitlines() if line.startswith("STEP")]
    steps = np.array([[-float(dy), -float(dx), -float(dphi)] for _, _, dx, dy, dphi, *_ in lines])
    seen, told = [], []
    for before, after in pairwise(open_log(folder).scans()):
        shared, i, j = np.intersect1d(
            before.ids[before.ids >= 0], after.ids[after.ids >= 0], return_indices=True
        )
        if len(shared) < 4:
            continue
        there, here = before.points_robot[before.ids >= 0][i], after.points_robot[after.ids >= 0][j]
        R, t = fit_rigid(here, there)
        assert np.linalg.norm(here @ R.T + t - there, axis=1).max() < 0.25
        seen.append([*t, np.arctan2(R[1, 0], R[0, 0])])
        told.append(steps[after.iteration])
    assert len(seen) == 1958
    assert np.median(np.abs(told), axis=0)[[0, 2]].min() > 0.02
    assert (np.median(np.abs(np.subtract(seen, told)), axis=0) < [0.02, 0.012, 0.006]).all()
    assert np.corrcoef(np.transpose(seen)[2], np.transpose(told)[2])[0, 1] > 0.98


def test_real_log_goes_through_the_projects_own_format(shared_data: Path, tmp_path: Path) -> None:
    log = open_log(shared_data / "victoria-park")
    write_observation_csv(tmp_path / "observations.csv.gz", log)
    back = open_log(tmp_path)
    assert np.array_equal(back.points_robot, log.points_robot)
    assert np.array_equal(back.iteration, log.iteration)
    assert back.ids is not None
    assert np.array_equal(back.ids, log.ids)
    assert (back.first_iteration, back.end_iteration) == (log.first_iteration, log.end_iteration)


def motions_of_landmarks(folder: Path, fewest: int) -> Floats:
    """Return x, y, yaw of the odometry, and of landmarks by their ids in two scans (k, 2, 3)."""
    found = []
    for before, now in pairwise(open_log(folder).scans()):
        T = now.odometry
        _, i, j = np.intersect1d(before.ids, now.ids, return_indices=True)
        known = before.ids[i] >= 0
        if known.sum() >= fewest and np.isfinite(T).all():
            R, t = fit_rigid(now.points_robot[j[known]], before.points_robot[i[known]])
            seen = [*t, np.arctan2(R[1, 0], R[0, 0])]
            found.append([[T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])], seen])
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "fewest", "way_m", "turn_rad"),
    [("victoria-park", 6, 0.045, 0.002), ("dlr-circles", 5, 0.025, 0.006)],
)
def test_odometry_agrees_with_landmarks(
    shared_data: Path, name: str, fewest: int, way_m: float, turn_rad: float
) -> None:
    odometry, seen = motions_of_landmarks(shared_data / name, fewest).transpose(1, 0, 2)
    assert len(odometry) > 1000
    assert np.median(np.linalg.norm(odometry[:, :2] - seen[:, :2], axis=1)) < way_m
    assert np.median(np.abs(odometry[:, 2] - seen[:, 2])) < turn_rad
    assert np.polyfit(odometry[:, 2], seen[:, 2], 1)[0] == pytest.approx(1, abs=0.06)
    assert np.polyfit(odometry[:, 1], seen[:, 1], 1)[0] == pytest.approx(1, abs=0.1)


def test_odometry_agrees_with_the_simulated_truth(shared_data: Path) -> None:
    logs = {
        shared_data / "slsjf-sim-8240": (slsjf.read_ground_truth, 0.003, 0.006),
        shared_data / "mrpt-kf-slam" / "kf-slam_demo.observations.csv.gz": (
            read_ground_truth,
            0.05,
            2e-4,
        ),
        shared_data / "mrpt-kf-slam" / "kf-slam_6D_demo.observations.csv.gz": (
            read_ground_truth,
            0.1,
            0.003,
        ),
    }
    for path, (truth, way_m, turn_rad) in logs.items():
        odometry, poses = open_log(path).odometry, truth(path)[2]
        n = len(odometry)
        error = np.linalg.inv(odometry[1:]) @ np.linalg.inv(poses[: n - 1]) @ poses[1:n]
        assert np.median(np.linalg.norm(error[:, :3, 3], axis=1)) < way_m
        turns = Rotation.from_matrix(error[:, :3, :3]).magnitude()
        assert np.median(turns) < turn_rad
