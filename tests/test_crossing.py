"""Planes and points from the same raw points: the points, the comparison, and Fig. 7."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from relmap.core.arrays import Ints
from relmap.core.errors import RelmapError
from relmap.evaluation.surface_points import (
    METHODS,
    Method,
    VariantRun,
    scan_surface_points,
    wall_points,
)
from relmap.figures import figure07
from relmap.figures.figure07 import NOISE, Crossing, run_crossing
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


def rows_of(method: Method, errors: list[float | None], coverage: list[float]) -> list[VariantRun]:
    return [
        VariantRun(method, 0.2, 0.1 * (k + 1), 0.02 * (k + 1), seed, e, c, e, 1.0)
        for k, (e, c) in enumerate(zip(errors, coverage, strict=True))
        for seed in range(3)
    ]


def crossing() -> Crossing:
    """Planes of 0.02 m throughout; points from 0.01 to 0.04 m, lost from 0.3 on without ids."""
    runs = rows_of("planes", [0.02] * 4, [1.0] * 4)
    runs += rows_of("points", [0.015, 0.018, None, None], [0.9, 0.7, 0.0, 0.0])
    runs += rows_of("points, ids given", [0.01, 0.015, 0.025, 0.04], [1.0] * 4)
    return Crossing(0.2, tuple(runs))


def test_crossing_lies_where_the_lines_cross() -> None:
    data = crossing()
    assert data.planes_ahead("points, ids given") == pytest.approx((0.25, 0.4))
    assert data.planes_ahead("points") == pytest.approx((0.3, 0.4))
    assert data.fails_at("points") == pytest.approx(0.3)
    assert data.fails_at("planes") is None
    assert figure07.CROSSING.judge([data]).ours == (
        "Points 0.2 m apart: planes have the better map from 0.30, from 0.25 if the ids of points "
        "were given; points lose half from 0.30, planes nowhere."
    )


def test_maps_that_failed_overtake_nothing() -> None:
    runs = rows_of("planes", [0.001] * 2, [0.4] * 2)
    runs += rows_of("points", [0.5] * 2, [0.6] * 2)
    data = Crossing(0.2, tuple(runs))
    assert data.planes_ahead("points") is None
    assert data.fails_at("planes") == pytest.approx(0.1)


def test_planes_may_fall_behind_again() -> None:
    runs = rows_of("planes", [0.02, 0.02, 0.02, 0.09], [1.0] * 4)
    runs += rows_of("points", [0.01, 0.03, 0.03, 0.03], [1.0] * 4)
    assert Crossing(0.2, tuple(runs)).planes_ahead("points") == pytest.approx((0.15, 0.3))
    runs = rows_of("planes", [0.02] * 4, [1.0] * 4)
    runs += rows_of("points", [0.01, 0.01, None, None], [0.3, 0.9, 0.0, 0.0])
    assert Crossing(0.2, tuple(runs)).planes_ahead("points") == pytest.approx((0.3, 0.4))


def test_rows_of_the_crossing() -> None:
    made = figure07.CROSSING.judge([crossing()]).table
    rows = list(made.rows)
    assert len(rows) == 36
    assert list(made.columns[:3]) == ["method", "spacing_m", "noise"]
    missing = [row for row in rows if row[5] == ""]
    assert {row[0] for row in missing} == {"points"}


def test_picture_of_the_crossing_shows_medians() -> None:
    figure = figure07.CROSSING.draw([crossing()])
    axes = figure.axes[0]
    lines = {line.get_label(): np.asarray(line.get_ydata()) for line in axes.get_lines()}
    assert lines["points, ids given, median"].tolist() == [0.01, 0.015, 0.025, 0.04]
    drawn = lines["points, median"]
    assert np.isfinite(drawn).tolist() == [True, True, False, False]


def test_every_method_is_run_on_every_cell() -> None:
    counted: list[int] = []

    def progress(cells: Sequence[Any]) -> Sequence[Any]:
        counted.append(len(cells))
        return cells

    (data,) = run_crossing([0.4], [0.02], [1, 2], iterations=15, progress=progress)
    assert counted == [2]
    assert [row.method for row in data.runs] == [*METHODS, *METHODS]
    known = [row for row in data.runs if row.method == "points, ids given"]
    assert all(row.sigma == pytest.approx(0.008) for row in data.runs)
    # With known association and 20 observations of most points, the map beats one observation.
    assert all(row.map_rmse_m is not None and row.map_rmse_m < 0.012 for row in known)


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
    whats = [row[0] for row in figure07.SEVEN.judge(maps).table.rows]
    assert whats.count("mapped wall") == len(maps.planes.shapes)
    assert whats.count("true wall") == len(maps.true_walls)
    assert whats.count("mapped point") == len(maps.points.shapes)
    titles = [axes.get_title() for axes in figure07.SEVEN.draw(maps).axes]
    assert f"{maps.planes.run.map_rmse_m:.3f} m" in titles[0]
    assert titles[1].startswith("points: ")


def test_verdict_on_both_maps(maps: BothMaps) -> None:
    judge, planes = figure07.SEVEN.judge, maps.planes
    found = judge(maps)
    assert found.verdict == "borne out"
    assert found.value == planes.run.map_rmse_m
    run = replace(maps.points.run, map_rmse_m=planes.run.map_rmse_m, coverage=1.0)
    as_good = replace(maps, points=replace(maps.points, run=run))
    assert judge(as_good).verdict == "partly borne out"
    lost = replace(planes, run=replace(planes.run, coverage=0.1))
    assert judge(replace(as_good, planes=lost)).verdict == "not borne out"


def test_verdict_on_the_crossing() -> None:
    found = figure07.CROSSING.judge([crossing()])
    assert found.verdict == "borne out"
    assert found.value == pytest.approx(0.3)
    runs = rows_of("planes", [0.02] * 2, [1.0] * 2) + rows_of("points", [0.01] * 2, [1.0] * 2)
    runs += rows_of("points, ids given", [0.01] * 2, [1.0] * 2)
    assert figure07.CROSSING.judge([Crossing(0.2, tuple(runs))]).verdict == "not borne out"
