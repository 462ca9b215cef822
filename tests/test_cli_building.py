"""``relmap simulate building``: the files and columns of the contract."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from relmap.cli import main
from relmap.datasets import open_scans
from relmap.io.files import read_tum
from relmap.plots.planes import plot_building
from relmap.simulation import simulate_building
from tests.commands import Check, names, snapshot, table

OPTIONS = ["--points", "200", "--iterations", "40", "--seed", "3"]


def simulate(folder: Path, *options: str) -> None:
    assert main(["simulate", "building", "-o", str(folder), *options]) == 0


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("world") / "building"
    simulate(folder, *OPTIONS)
    return folder


def test_it_writes_scans_and_truth(world: Path) -> None:
    assert names(world) == ["building.png", "scans.npz", "truth"]
    assert names(world / "truth") == ["planes.csv", "trajectory.tum"]
    run = simulate_building(points=200, iterations=40, seed=3)
    with np.load(world / "scans.npz") as scans:
        assert set(scans) == {"points", "iteration", "stamps_s", "view_rad", "range_m"}
        assert scans["points"].shape == (8000, 3)
        assert scans["iteration"].tolist() == np.repeat(np.arange(40), 200).tolist()
        assert scans["stamps_s"].tolist() == run.stamps_s.tolist()
    planes = table(world / "truth" / "planes.csv")
    columns = ["plane", "x0", "y0", "x1", "y1", "z0", "z1"]
    assert list(planes[0])[:7] == columns
    assert [int(row["plane"]) for row in planes] == list(range(len(run.walls)))
    assert [[float(row[name]) for name in columns[1:]] for row in planes] == run.walls.tolist()
    seen = [[int(row[name]) for name in ("scans", "corner0", "corner1")] for row in planes]
    assert seen == run.times_seen().tolist()
    stamps_s, poses = read_tum(world / "truth" / "trajectory.tum")
    assert stamps_s.tolist() == run.stamps_s.tolist()
    np.testing.assert_allclose(poses, run.trajectory, atol=1e-12)


def test_output_is_a_log_of_point_scans(world: Path) -> None:
    run = simulate_building(points=200, iterations=40, seed=3)
    log = open_scans(world)
    for scan, true in zip(log.scans(), run.scans, strict=True):
        assert scan.points_robot.tobytes() == true.points.tobytes()
    assert (log.sensor.view_rad, log.sensor.range_m) == (run.sensor.view_rad, run.sensor.range_m)


def test_the_same_seed_writes_the_same_bytes(world: Path, tmp_path: Path) -> None:
    simulate(tmp_path / "same", *OPTIONS)
    assert snapshot(tmp_path / "same") == snapshot(world)
    simulate(tmp_path / "other", *OPTIONS[:-1], "4")
    other = snapshot(tmp_path / "other")
    assert all(other[name] != data for name, data in snapshot(world).items() if data is not None)


def test_a_laser_writes_planar_scans(tmp_path: Path) -> None:
    simulate(tmp_path, *OPTIONS, "--sampling", "laser", "--world", "panels")
    log = open_scans(tmp_path)
    assert log.dimension == 2
    assert len(log) == 40
    assert 0 < min(len(scan.points_robot) for scan in log.scans()) < 200


def test_a_laser_has_the_given_beams_view_and_steps(tmp_path: Path) -> None:
    options = ["--beams", "90", "--view", "270", "--range", "5", "--step", "0.5"]
    simulate(tmp_path, *OPTIONS[2:], *options, "--people", "3", "--clutter", "0.1")
    log = open_scans(tmp_path)
    assert log.sensor.view_rad == pytest.approx(np.deg2rad(270))
    assert log.sensor.range_m == 5.0
    assert np.diff(log.stamps_s) == pytest.approx(0.2 * 0.5 / 0.22)
    bearings = [np.arctan2(*scan.points_robot.T[::-1]) for scan in log.scans()]
    beam = np.concatenate(bearings) / np.deg2rad(270 / 89) + 44.5
    assert 60 < max(map(len, bearings)) <= 90
    far = np.concatenate([np.hypot(*scan.points_robot.T) for scan in log.scans()]) > 1.0
    np.testing.assert_allclose(beam[far], np.rint(beam[far]), atol=1e-6)


def test_the_truth_contains_the_observed_extent_of_walls(world: Path) -> None:
    run = simulate_building(points=200, iterations=40, seed=3)
    rows = table(world / "truth" / "planes.csv")
    told = [[float(row[name] or "nan") for name in ("seen0", "seen1")] for row in rows]
    np.testing.assert_array_equal(told, run.seen_extents())
    assert 0 < np.isfinite(told).all(axis=1).sum() < len(rows)


def test_bad_options_change_nothing(refused: Check) -> None:
    for option, value, expected in (
        ("--points", "0", "points"),
        ("--sigma", "-1", "sigma"),
        ("--sigma", "nan", "sigma"),
        ("--iterations", "0", "iterations"),
        ("--loops", "0", "loops"),
        ("--seed", "-1", "seed"),
        ("--world", "moon", "'building', 'panels'"),
        ("--sampling", "sonar", "'surface', 'rays', 'laser'"),
        ("--beams", "0", "points"),
        ("--view", "360", "view"),
        ("--view", "400", "--view is 400.0"),
        ("--range", "0", "range"),
        ("--step", "0", "step"),
        ("--people", "1", "sampling must be laser"),
        ("--clutter", "0.1", "sampling must be laser"),
        ("--world", "glass", "sampling must be laser"),
    ):
        assert expected in refused("simulate", "building", "-o", "new", option, value)


@pytest.mark.parametrize("more", ["--points 50", "--sampling rays"])
def test_beams_replace_other_options(refused: Check, more: str) -> None:
    building = ["simulate", "building", "-o", "new", "--beams", "100"]
    assert "omit these" in refused(*building, *more.split())


def test_the_picture_shows_every_wall_and_the_whole_path() -> None:
    run = simulate_building(points=50, iterations=40, seed=3)
    axes = plot_building(run).axes[0]
    (walls,) = axes.collections
    assert isinstance(walls, LineCollection)
    drawn = np.array([path.vertices for path in walls.get_paths()])
    np.testing.assert_allclose(drawn.reshape(-1, 4), run.walls[:, :4])
    lines = {str(line.get_label()): np.array(line.get_xydata()) for line in axes.lines}
    np.testing.assert_allclose(lines["path of the robot"], run.trajectory[:, :2, 3])
    ends = np.concatenate([drawn.reshape(-1, 2), run.trajectory[:, :2, 3]])
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    assert (ends > low).all()
    assert (ends < high).all()
