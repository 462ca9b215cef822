"""Real logs of point scans: the counts that their descriptions state, and the ground truth."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from relmap.core.arrays import Floats
from relmap.datasets import open_scans, read_relations
from relmap.datasets.scans import ScanLog

LASER = "carmen-laser2d"


@pytest.mark.parametrize(
    ("name", "scans", "beams", "path_m", "step_m", "turn_deg", "far_m"),
    [
        ("freiburg-079-corrected", 4791, 360, 422, 0.099, 1.9, 37),
        ("fr079", 1464, 360, 391, 0.31, 9.4, 37),
        ("mit-cscail", 1051, 361, 383, 0.40, 7.5, 43),
        ("csail-corrected", 406, 361, 380, 1.05, 20, 36),
        ("belgioioso-corrected", 395, 361, 219, 0.45, 20, 80),
        ("freiburg-101-corrected", 292, 360, 211, 1.0, 17, 74),
        ("orebro-corrected", 237, 181, 221, 1.05, 15, 32.7),
        ("fhw-corrected", 488, 180, 406, 1.0, 8, 45),
        ("edmonton-corrected", 340, 180, 324, 1.0, 9, 51),
    ],
)
def test_carmen_logs(
    real_scans: Callable[[str], ScanLog],
    name: str,
    scans: int,
    beams: int,
    path_m: float,
    step_m: float,
    turn_deg: float,
    far_m: float,
) -> None:
    log = real_scans(f"{LASER}/{name}.log.gz")
    assert (len(log), log.dimension) == (scans, 2)
    points = [scan.points_robot for scan in log.scans()]
    counts = [len(p) for p in points]
    assert beams / 3 < min(counts)
    assert max(counts) in (beams, beams - 1)
    assert np.linalg.norm(np.concatenate(points), axis=1).max() < far_m
    # Beams go from right to left.
    bearings = [np.arctan2(p[:, 1], p[:, 0]) for p in points[:50]]
    assert np.mean(np.concatenate([np.diff(b) > 0 for b in bearings])) > 0.99
    steps = np.linalg.norm(np.diff(log.poses[:, :2, 3], axis=0), axis=1)
    assert steps.sum() == pytest.approx(path_m, abs=0.6)
    assert np.median(steps) == pytest.approx(step_m, rel=0.06)
    yaw = np.unwrap(np.arctan2(log.poses[:, 1, 0], log.poses[:, 0, 0]))
    assert np.rad2deg(np.median(np.abs(np.diff(yaw)))) == pytest.approx(turn_deg, abs=0.5)
    assert (np.diff(log.stamps_s) > 0).all()


def poses_at(times_s: Floats, stamps_s: Floats, poses: Floats) -> Floats:
    """Return planar poses (t, 4, 4) between those of a log."""
    yaw = np.interp(times_s, stamps_s, np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0])))
    T = np.tile(np.eye(4), (len(times_s), 1, 1))
    T[:, 0, 0] = T[:, 1, 1] = np.cos(yaw)
    T[:, 1, 0], T[:, 0, 1] = np.sin(yaw), -np.sin(yaw)
    for axis in (0, 1):
        T[:, axis, 3] = np.interp(times_s, stamps_s, poses[:, axis, 3])
    return T


def test_the_graph_of_freiburg_079_agrees_with_the_relations(
    shared_data: Path, real_scans: Callable[[str], ScanLog]
) -> None:
    """The description says 0.043 m and 0.52 degrees, at exact stamps."""
    relations = read_relations(shared_data / LASER / "fr079.relations")
    assert len(relations.begin_s) == 1685
    assert relations.begin_s.min() == pytest.approx(1215.6, abs=0.1)
    assert relations.end_s.max() == pytest.approx(2258.9, abs=0.1)
    log = real_scans(f"{LASER}/fr079.log.gz")
    begin = poses_at(relations.begin_s, log.stamps_s, log.poses)
    end = poses_at(relations.end_s, log.stamps_s, log.poses)
    error = np.linalg.inv(relations.T_begin_end) @ np.linalg.inv(begin) @ end
    times = np.column_stack([relations.begin_s, relations.end_s])
    exact = np.abs(times[..., None] - log.stamps_s).min(axis=2).max(axis=1) < 0.002
    assert exact.sum() > 100
    assert np.hypot(error[exact, 0, 3], error[exact, 1, 3]).mean() == pytest.approx(0.043, abs=5e-4)
    turn = np.abs(np.arctan2(error[exact, 1, 0], error[exact, 0, 0]))
    assert np.rad2deg(turn).mean() == pytest.approx(0.52, abs=0.01)


def distances_to_the_scan_before(points: list[Floats], poses: Floats) -> Floats:
    """Return how far points are from the nearest of the scan before, both placed by the poses."""
    placed = [
        p @ T[: p.shape[1], : p.shape[1]].T + T[: p.shape[1], 3]
        for p, T in zip(points, poses, strict=True)
    ]
    return np.concatenate([cKDTree(before).query(after)[0] for before, after in pairwise(placed)])


@pytest.mark.parametrize(
    ("name", "median_m"),
    [
        (f"{LASER}/freiburg-079-corrected.log.gz", 0.02),
        ("mrpt-sim-laser2d/simul.scans.csv.gz", 0.07),
    ],
)
def test_scans_coincide_at_the_reference_poses(
    real_scans: Callable[[str], ScanLog], name: str, median_m: float
) -> None:
    """Mirrored scans, or poses that belong to other scans, do not.

    Half a degree apart, the beams of the simulation lie further from each other, as its walls do.
    """
    log = real_scans(name).between(100, 500)
    points = [scan.points_robot for scan in log.scans()]
    right = np.median(distances_to_the_scan_before(points, log.poses))
    mirrored = [p * [1, -1] for p in points]
    assert right < median_m
    assert np.median(distances_to_the_scan_before(mirrored, log.poses)) > 1.2 * right
    for shift in (-1, 1):
        others = np.roll(log.poses, shift, axis=0)[2:-2]
        assert np.median(distances_to_the_scan_before(points[2:-2], others)) > 1.05 * right


def test_mrpt_simulated_laser(shared_data: Path) -> None:
    log = open_scans(shared_data / "mrpt-sim-laser2d")
    assert (len(log), log.dimension) == (1733, 2)
    steps = np.linalg.norm(np.diff(log.poses[:, :2, 3], axis=0), axis=1)
    assert steps.sum() == pytest.approx(197, abs=0.5)
    assert np.median(steps) == pytest.approx(0.079, abs=5e-4)
    assert (steps > 0.5).sum() == 30
    assert {len(scan.points_robot) for scan in log.scans()} == {361}


def test_lidar_in_a_hall(shared_data: Path) -> None:
    log = open_scans(shared_data / "lidar3d-hall")
    assert (len(log), log.dimension) == (34, 3)
    steps = np.linalg.norm(np.diff(log.poses[:, :3, 3], axis=0), axis=1)
    assert steps.sum() == pytest.approx(11.7, abs=0.05)
    assert np.median(steps) == pytest.approx(0.40, abs=0.005)
    assert np.ptp(log.stamps_s) == pytest.approx(17, abs=0.6)
    first, second = (scan.points_robot for scan in log.between(0, 2).scans())
    assert len(first) == 74376
    assert 70_000 < len(second) < 91_000
    near = [p[np.linalg.norm(p, axis=1) < 10][::20] for p in (first, second)]
    assert np.median(distances_to_the_scan_before(near, log.poses[:2])) < 0.2
