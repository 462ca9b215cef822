"""Planes and points from the same raw points: the points, the comparison, and Fig. 7."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap.core.arrays import Ints
from relmap.core.errors import RelmapError
from relmap.evaluation.surface_points import scan_surface_points, wall_points
from relmap.figures import figure07
from relmap.figures.figure07 import NOISE
from relmap.plots.variants import BothMaps, both_maps
from relmap.simulation import simulate_building

BUILDING = simulate_building(points=1, sigma=0.0, iterations=8, seed=5)


def squares_of(spacing_m: float) -> Ints:
    """Count the squares of each wall."""
    walls = BUILDING.walls
    length = np.linalg.norm(walls[:, 2:4] - walls[:, :2], axis=1)
    columns = np.maximum(1, np.round(length / spacing_m))
    rows = np.maximum(1, np.round((walls[:, 5] - walls[:, 4]) / spacing_m))
    return np.asarray(columns * rows, dtype=np.int64)


def test_one_point_in_each_square_of_a_wall() -> None:
    seen = scan_surface_points(BUILDING, 0.5, 0.0, seed=0)
    places = seen.points_truth.landmarks_map
    squares = squares_of(0.5)
    assert len(places) == squares.sum()
    first, across = BUILDING.walls[0, :2], BUILDING.walls[0, 2:4] - BUILDING.walls[0, :2]
    own = places[: squares[0]]
    normal = np.array([-across[1], across[0]]) / np.linalg.norm(across)
    off = (own[:, :2] - first) @ normal
    np.testing.assert_allclose(off, 0.0, atol=1e-12)


def test_points_are_seen_where_their_stretch_is() -> None:
    """By brute force: no wall hides a point from the robot, and it is within view."""
    seen = scan_surface_points(BUILDING, 0.4, 0.0, seed=0)
    T = BUILDING.trajectory[3]
    robot = (seen.points_truth.landmarks_map - T[:3, 3]) @ T[:3, :3]
    ends = (BUILDING.walls[:, :4].reshape(-1, 2, 2) - T[:2, 3]) @ T[:2, :2]
    front = ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0] > 0
    expected = []
    own_front = np.repeat(front, squares_of(0.4))
    for k, (x, y, _) in enumerate(robot):
        if not own_front[k] or np.hypot(x, y) > 8.0 or abs(np.arctan2(y, x)) > np.pi / 4:
            continue
        p, r = ends[front, 0], ends[front, 1] - ends[front, 0]
        cross = x * r[:, 1] - y * r[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (p[:, 0] * r[:, 1] - p[:, 1] * r[:, 0]) / cross
            t = (p[:, 0] * y - p[:, 1] * x) / cross
        met = (t >= 0) & (t <= 1) & (s > 0)
        if met.any() and abs(s[met].min() - 1) < 1e-9:
            expected.append(k)
    scan = list(seen.points.scans())[3]
    assert sorted(scan.ids.tolist()) == expected


def test_both_variants_get_the_same_noisy_points() -> None:
    seen = scan_surface_points(BUILDING, 0.3, 0.05 / 0.3, seed=1)
    errors = []
    for k, (scan, points) in enumerate(zip(seen.scans.scans(), seen.points.scans(), strict=True)):
        assert scan.points_robot.tobytes() == points.points_robot.tobytes()
        T = BUILDING.trajectory[k]
        assert points.ids is not None
        true = (seen.points_truth.landmarks_map[points.ids] - T[:3, 3]) @ T[:3, :3]
        errors.append(points.points_robot - true)
    noise = np.concatenate(errors)
    np.testing.assert_allclose(noise.std(axis=0), 0.05, rtol=0.1)
    again = scan_surface_points(BUILDING, 0.3, 0.05 / 0.3, seed=1)
    assert again.points.points_robot.tobytes() == seen.points.points_robot.tobytes()


def test_impossible_points_are_refused() -> None:
    with pytest.raises(RelmapError, match="spacing is 0"):
        scan_surface_points(BUILDING, 0.0, 0.1, 0)


@pytest.fixture(scope="module")
def maps() -> BothMaps:
    return both_maps(wall_points(0.25, NOISE, 0, 12))


def test_planes_hold_where_points_do_not(maps: BothMaps) -> None:
    planes, points = maps.planes.run, maps.points.run
    assert planes.sigma == pytest.approx(0.075)
    assert planes.map_rmse_m <= 1.2 * planes.sigma
    assert planes.coverage >= 0.8
    assert points.coverage <= 0.5


def test_rows_and_picture_of_both_maps(maps: BothMaps) -> None:
    whats = [row[0] for row in figure07.FIGURE.judge(maps).table.rows]
    assert whats.count("mapped wall") == len(maps.planes.shapes)
    assert whats.count("true wall") == len(maps.true_walls)
    assert whats.count("mapped point") == len(maps.points.shapes)
    titles = [axes.get_title() for axes in figure07.FIGURE.draw(maps).axes]
    assert f"{maps.planes.run.map_rmse_m:.3f} m" in titles[0]
    assert titles[1].startswith("points: ")


def test_verdict_on_both_maps(maps: BothMaps) -> None:
    judge, planes = figure07.FIGURE.judge, maps.planes
    found = judge(maps)
    assert found.verdict == "borne out"
    assert found.value == planes.run.map_rmse_m
    run = replace(maps.points.run, map_rmse_m=planes.run.map_rmse_m, coverage=1.0)
    as_good = replace(maps, points=replace(maps.points, run=run))
    assert judge(as_good).verdict == "partly borne out"
    lost = replace(planes, run=replace(planes.run, coverage=0.1))
    assert judge(replace(as_good, planes=lost)).verdict == "not borne out"
