"""Clouds of a tilted sensor: the vertical, level 2-D scans, and floor plans from them."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relmap import PlaneSegmenter, RelmapError
from relmap.cli import main
from relmap.datasets import write_scans_npz
from relmap.datasets.scans import ScanLog
from relmap.evaluation.levelling import shows_floors
from relmap.segmentation.space import PatchSegmenter, level_scan, vertical
from relmap.simulation.storey import Storey, simulate_storey
from tests.commands import load
from tests.worlds import turn

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.fixture(scope="module")
def storey() -> Storey:
    return simulate_storey("lidar", 0.01, 12)


def test_vertical_is_that_of_floor_and_walls(storey: Storey) -> None:
    for scan, pose in zip(storey.scans, storey.trajectory, strict=True):
        up = vertical(PatchSegmenter().fit(scan).patches_)
        assert pose[:3, :3][2] @ up > np.cos(np.deg2rad(0.3))


def test_level_scan_shows_the_farthest_walls(storey: Storey) -> None:
    points = level_scan(storey.scans[0], PatchSegmenter())
    pose = storey.trajectory[0]
    assert 300 < len(points) <= 720
    assert (np.diff(np.arctan2(points[:, 1], points[:, 0])) > 0).all()
    ahead = pose[:3, 0] - pose[2, 0] * np.array([0.0, 0.0, 1.0])
    there = points @ turn(np.arctan2(ahead[1], ahead[0])).T + pose[:2, 3]
    walls = np.stack([there[:, 0], there[:, 1], there[:, 0] - 6, there[:, 1] - 7, there[:, 0] - 12])
    assert (np.abs(walls).min(axis=0) < 0.05).mean() > 0.9


def test_what_shows_no_walls_has_no_level_scan() -> None:
    floor = np.random.default_rng(0).uniform(-4, 4, (4000, 3)) * [1, 1, 0] - [0, 0, 1.2]
    assert len(level_scan(floor, PatchSegmenter())) == 0
    anything = np.random.default_rng(1).uniform(-4, 4, (300, 3))
    assert len(level_scan(anything, PatchSegmenter())) == 0


def test_a_given_vertical_levels_what_shows_none() -> None:
    """One wall, 3 m ahead, of which a sensor that is rolled by 30 degrees sees a slanted part."""
    y, z = np.meshgrid(np.arange(-2.0, 2.0, 0.05), np.arange(-1.0, 1.0, 0.05))
    upright = np.column_stack([np.full(y.size, 3.0), y.ravel(), z.ravel()])
    rolled = Rotation.from_euler("x", 30, degrees=True)
    cloud = rolled.inv().apply(upright)
    assert len(level_scan(cloud, PatchSegmenter())) == 0
    up = 9.81 * rolled.inv().apply([0.0, 0.0, 1.0])
    points = level_scan(cloud, PatchSegmenter(), up)
    assert np.abs(points[:, 0] - 3.0).max() < 1e-9
    assert np.ptp(points[:, 1]) > 3.8


@pytest.mark.parametrize("nothing", [[], np.empty((0, 2)), np.empty((0, 3))])
def test_an_empty_cloud_is_an_empty_level_scan(nothing: Any) -> None:
    assert level_scan(nothing, PatchSegmenter(), [0, 0, 1]).shape == (0, 2)


def test_a_cloud_may_be_a_list(storey: Storey) -> None:
    points = level_scan(storey.scans[0].tolist(), PatchSegmenter())
    np.testing.assert_array_equal(points, level_scan(storey.scans[0], PatchSegmenter()))


@pytest.mark.parametrize("up", [[0, 0, 0], [1, 0], [1.0, 0.01, 0], [0, np.nan, 1], "up"])
def test_a_vertical_that_is_none_is_an_error(up: Any) -> None:
    with pytest.raises(RelmapError, match=r"up (is|must be)"):
        level_scan(np.ones((100, 3)), PatchSegmenter(), up)


@pytest.mark.parametrize("has_floor", [True, False])
def test_floors_are_seen_in_rings_far_apart_too(has_floor: bool) -> None:
    """16 rings, level, 1 m above the floor of a hall: neighbouring rings are half a metre apart."""
    yaw, pitch = np.meshgrid(np.arange(0.01, 6.28, 0.02), np.deg2rad(np.linspace(-20, 20, 16)))
    ways = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    inside = np.array([[7.0], [5.0], [1.0 if has_floor else 99.0]])  # half of the hall
    cloud = (ways.reshape(3, -1) * (inside / np.abs(ways.reshape(3, -1))).min(axis=0)).T
    log = ScanLog(3, np.zeros(1), lambda _: cloud)
    assert shows_floors(log) == has_floor
    refused = pytest.raises(RelmapError, match="not upright") if has_floor else nullcontext()
    with refused:
        PlaneSegmenter().fit(cloud)


def test_a_carried_lidar_gives_a_floor_plan(
    storey: Storey, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scans_npz(tmp_path / "scans.npz", storey.scans, storey.stamps_s)
    source, planes = str(tmp_path / "scans.npz"), ["--variant", "planes"]
    assert main(["map", source, "-o", str(tmp_path / "none"), *planes, "--level", "none"]) == 2
    refused = capsys.readouterr().err
    assert "--level" in refused
    assert "not upright" in refused
    out = tmp_path / "plan"
    assert main(["map", source, "-o", str(out), *planes]) == 0
    assert "levelled" in capsys.readouterr().err
    path = np.loadtxt(out / "trajectory.tum")[:, 1:3]
    true = storey.trajectory[:, :2, 3]
    assert len(path) == len(true)
    lengths = (np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (path, true))
    assert np.abs(np.subtract(*lengths)).max() < 0.02
    assert main(["localise", source, "--map", str(out), "-o", str(tmp_path / "where")]) == 0
    printed = capsys.readouterr()
    assert "levelled" in printed.err
    assert "of 12 scans in the map" in printed.out


@pytest.mark.parametrize("high", [0.0, 2.4])
def test_clouds_without_walls_are_refused_in_one_line(
    high: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    floors = [rng.uniform(-4, 4, (4000, 3)) * [1, 1, 0] - [0, 0, 1.2] for _ in range(2)]
    clouds = [np.concatenate([floor, floor + np.array([0, 0, high])]) for floor in floors]
    write_scans_npz(tmp_path / "scans.npz", clouds, np.arange(2.0))
    arguments = [str(tmp_path / "scans.npz"), "-o", str(tmp_path / "out"), "--variant", "planes"]
    assert main(["map", *arguments]) == 2
    assert "cannot be levelled" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", [["--level", "auto"], ["--segmenter", "em"]])
def test_options_of_walls_are_refused_for_others(
    option: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["map", "log", "-o", str(tmp_path / "out"), "--variant", "planes3d"]
    assert main([*arguments, *option]) == 2
    assert "require --variant planes" in capsys.readouterr().err


def test_a_segmenter_can_be_chosen(tmp_path: Path) -> None:
    world = ["--sampling", "laser", "--points", "181", "--iterations", "4"]
    assert main(["simulate", "building", "-o", str(tmp_path / "world"), *world]) == 0
    arguments = ["--variant", "planes", "--segmenter", "ransac"]
    assert main(["map", str(tmp_path / "world"), "-o", str(tmp_path / "out"), *arguments]) == 0
    assert '"segmenter": "ransac"' in (tmp_path / "out" / "summary.json").read_text()


def test_a_real_hall_gives_a_floor_plan(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hall = shared_data / "lidar3d-hall"
    if not hall.is_dir():
        pytest.skip("lidar3d-hall is not there")
    out = tmp_path / "plan"
    arguments = ["--variant", "planes", "--scans", "0:8"]
    assert main(["map", str(hall), "-o", str(out), *arguments]) == 0
    assert "submaps" not in capsys.readouterr().out
    assert main(["evaluate", str(out), "--truth", str(hall)]) == 0
    evaluation = load(out / "evaluation.json")
    assert len(np.loadtxt(out / "trajectory.tum")) == 8
    assert evaluation["ate_m"] < 0.03
