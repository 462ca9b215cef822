"""What looks certain but is not: places found by chance, turns about a line, false landmarks."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.spatial.transform import Rotation

from relmap import PointMapper
from relmap.core.arrays import Floats
from tests.worlds import finished, refined


def circuit(landmarks: Floats, sigma_m: float, rng: np.random.Generator) -> list[Floats]:
    """Return the scans of a circle of 12 m among planar landmarks, seen up to 9 m."""
    scans = []
    for angle in np.linspace(0, 2 * np.pi, 120, endpoint=False):
        along = np.array([np.cos(angle), np.sin(angle)])
        R = np.column_stack([along, [-along[1], along[0]]])
        points = (landmarks - 12 * along) @ R
        near = points[np.linalg.norm(points, axis=1) < 9]
        scans.append(near + sigma_m * rng.standard_normal(near.shape))
    return scans


def test_a_scan_of_another_place_is_not_found_by_chance() -> None:
    rng = np.random.default_rng(11)
    scans = circuit(rng.uniform(-25, 25, (250, 2)), 0.1, rng)
    mapper = refined(PointMapper(), scans)
    found = [np.isfinite(mapper.localise(points)).all() for points in scans]
    assert np.mean(found) >= 0.95
    for n in (8, 10):
        others = rng.uniform(-7, 7, (40, n, 2))
        places = [mapper.locate(points) for points in others]
        assert np.isnan([place.T_map_robot for place in places]).all()
        assert all(place.n_places != 1 for place in places)
        assert not any(mapper.take_up(points) for points in others)


def test_no_pose_is_reported_where_noise_alone_determines_the_turn_about_a_row() -> None:
    for spread_m, share in ((0.0, 0.0), (0.02, 0.05), (0.5, 1.0)):
        rng = np.random.default_rng(5)
        row = spread_m * rng.standard_normal((60, 3)) + [0.0, 0.0, 3.0]
        row[:, 0] = np.cumsum(rng.uniform(0.5, 2, 60)) - 30
        scans = []
        for x in np.linspace(-20, 10, 100):
            points = row - [x, 0.0, 0.0]
            points = points[np.linalg.norm(points, axis=1) < 10]
            scans.append(points + 0.02 * rng.standard_normal(points.shape))
        mapper = refined(PointMapper(), scans)
        assert len(mapper.map) > 25
        known = np.isfinite(mapper.trajectory[:, 0, 3])
        assert np.mean(known) <= share if share < 1 else known.all()


def test_no_pose_is_reported_where_two_landmarks_side_by_side_hardly_show_the_turn() -> None:
    rng = np.random.default_rng(4)
    landmarks = np.column_stack([20 * rng.random(12), 4 + rng.random(12)])
    landmarks[:2] = [[20.0, 4.0], [20.2, 4.1]]
    mapper = PointMapper()
    for k in range(40):
        points = landmarks - [k / 8, 0] + 0.05 * rng.standard_normal(landmarks.shape)
        n = 2 if k % 10 == 5 else 12
        mapper.update(points[:n], ids=np.arange(n))
    mapper.finish()
    mapper.refine()
    unknown = np.flatnonzero(np.isnan(mapper.trajectory[:, 0, 3]))
    assert unknown.tolist() == [5, 15, 25, 35]


def test_as_many_false_detections_as_true_ones_are_not_mapped() -> None:
    rng = np.random.default_rng(1)
    true = circuit(rng.uniform(-25, 25, (250, 2)), 0.03, rng)
    mixed = [np.vstack([one, rng.uniform(-9, 9, one.shape)]) for one in true]
    mapper, alone = refined(PointMapper(), mixed), refined(PointMapper(), true)
    assert len(alone.map) > 50
    assert abs(len(mapper.map) - len(alone.map)) <= 3


def test_noise_free_landmarks_are_mapped_once() -> None:
    rng, scans = np.random.default_rng(1), []
    landmarks = rng.uniform(-18, 18, (250, 3))
    for angle in np.linspace(0, 4 * np.pi, 150, endpoint=False):
        turn = [angle, 0.3 * np.sin(angle), 0.2 * np.cos(2 * angle)]
        p = np.array([9 * np.cos(angle), 9 * np.sin(angle), 2 * np.sin(angle)])
        points = (landmarks - p) @ Rotation.from_euler("zyx", turn).as_matrix()
        scans.append(rng.permutation(points[np.linalg.norm(points, axis=1) < 10]))
    positions = refined(PointMapper(), scans).map.positions
    apart = np.linalg.norm(positions[:, None] - positions, axis=2)
    assert len(positions) > 80
    assert np.sum(np.triu(apart < 1e-6, 1)) == 0


def test_rounded_observations_cause_no_numerical_warning() -> None:
    rng = np.random.default_rng(3)
    scans = [np.round(points) for points in circuit(rng.uniform(-25, 25, (200, 2)), 0.03, rng)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        finished(PointMapper(), scans)
