"""Beams without a return that a log gives the largest range, and beams on the robot itself."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.datasets import ScanLog, laser, open_scans
from relmap.datasets.laser import on_robot, usable_beams
from tests.logs import put
from tests.scanlogs import npz

Written = Callable[[Path, list[Floats]], ScanLog]
BEARINGS = np.deg2rad(np.arange(-90.0, 90.0))
REACH_M = 5.0


def hall(step: int) -> Floats:
    """Return the ranges, rounded to 0.01 m, in a hall of 4 by 9 m, 0.1 m a scan."""
    with np.errstate(divide="ignore"):
        sides = 2 / np.abs(np.sin(BEARINGS))
        ahead = (9 - 0.1 * step) / np.cos(BEARINGS)
    return np.asarray(np.minimum(sides, ahead).round(2))


def scans_npz(folder: Path, ranges_m: list[Floats]) -> ScanLog:
    points = [(r * [np.cos(BEARINGS), np.sin(BEARINGS)]).T for r in ranges_m]
    iteration = np.repeat(np.arange(len(points)), [len(scan) for scan in points])
    arrays = {"points": np.concatenate(points), "iteration": iteration}
    return open_scans(npz(folder / "scans.npz", **arrays, stamps_s=np.arange(len(points)) + 1.0))


def carmen_log(folder: Path, ranges_m: list[Floats]) -> ScanLog:
    lines = (
        f"FLASER 180 {' '.join(map(str, r))} 0 0 0 0 0 0 {k + 1} host 0"
        for k, r in enumerate(ranges_m)
    )
    return open_scans(put(folder, "\n".join(lines), "a.log"))


@pytest.mark.parametrize("written", [scans_npz, carmen_log])
def test_beams_at_the_largest_range_did_not_return(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, written: Written
) -> None:
    true = [hall(step) for step in range(10)]
    assert [len(scan.points_robot) for scan in written(tmp_path, true).scans()] == 10 * [180]
    assert not caplog.messages
    log = written(tmp_path, [np.minimum(ranges, REACH_M) for ranges in true])
    for scan, ranges in zip(log.scans(), true, strict=True):
        assert len(scan.points_robot) == np.sum(ranges < REACH_M) < 140
    assert log.sensor.range_m == pytest.approx(REACH_M, rel=1e-3)
    (message,) = caplog.messages
    assert message.endswith("end at the largest range, 5 m, and are treated as no return")


@pytest.mark.parametrize("written", [scans_npz, carmen_log])
def test_few_beams_down_a_corridor_did_not_return(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, written: Written
) -> None:
    """They are 4 degrees wide only; where the end of the corridor is seen, it is kept."""
    ends_m = 33 - 0.5 * np.arange(40.0)
    with np.errstate(divide="ignore"):
        sides_m = 1 / np.abs(np.sin(BEARINGS))
    true = [
        np.minimum(sides_m * (0.8 + 0.01 * end_m), end_m / np.cos(BEARINGS)).round(2)
        for end_m in ends_m
    ]
    assert [len(scan.points_robot) for scan in written(tmp_path, true).scans()] == 40 * [180]
    assert not caplog.messages
    none = [np.where(ranges < 25, ranges, 26) for ranges in true]
    none[0][90] = 40.0  # an error beyond the range
    log = written(tmp_path, none)
    for scan, ranges in zip(log.scans(), true, strict=True):
        assert len(scan.points_robot) == np.sum(ranges < 25) > 170
    assert log.sensor.range_m == pytest.approx(26, rel=1e-3)
    (message,) = caplog.messages
    assert message.endswith("end at the largest range, 26 m, and are treated as no return")


@pytest.mark.parametrize("written", [scans_npz, carmen_log])
@pytest.mark.parametrize("sd_m", [0.005, 0.02])
def test_the_range_of_beams_without_a_return_may_vary(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, written: Written, sd_m: float
) -> None:
    rng = np.random.default_rng(0)
    true = [hall(step) for step in range(40)]
    none_m = [REACH_M + rng.normal(0, sd_m, 180).round(3) for _ in true]
    log = written(
        tmp_path, [np.where(r < REACH_M, r, none) for r, none in zip(true, none_m, strict=True)]
    )
    for scan, ranges in zip(log.scans(), true, strict=True):
        assert len(scan.points_robot) == pytest.approx(np.sum(ranges < REACH_M), abs=6)
    assert REACH_M - 5 * sd_m < log.sensor.range_m < REACH_M - 2 * sd_m
    (message,) = caplog.messages
    assert "m before it, and are treated as no return" in message


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
@pytest.mark.parametrize("limit_m", [7.0, np.inf])
def test_points_of_clouds_at_the_largest_range_did_not_return(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, noise_m: float, limit_m: float
) -> None:
    """Noise puts a few returns beyond it. Where all rays return, all points are kept."""
    rng = np.random.default_rng(0)
    rays = rng.standard_normal((2000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    scans, kept = [], []
    for step in range(5):  # in a cube of 12 m, 0.1 m a scan
        ahead_m = (6 - 0.1 * step * np.sign(rays[:, 0])) / np.abs(rays[:, 0])
        true_m = np.minimum(ahead_m, (6 / np.abs(rays[:, 1:])).min(axis=1))
        range_m = true_m + noise_m * rng.standard_normal(2000)
        scans.append(rays * np.where(true_m < limit_m, range_m, limit_m)[:, None])
        kept.append(np.count_nonzero((true_m < limit_m) & (range_m < limit_m)))
    points, iteration = np.concatenate(scans), np.repeat(np.arange(5), 2000)
    file = npz(tmp_path / "scans.npz", points=points, iteration=iteration, stamps_s=np.arange(5.0))
    found = [len(scan.points_robot) for scan in open_scans(file).scans()]
    assert found == pytest.approx(kept, abs=3)  # A return may have just this range.
    said = [m for m in caplog.messages if m.endswith("7 m, and are treated as no return")]
    assert len(said) == np.isfinite(limit_m) == len(caplog.messages)


def test_the_outermost_ring_on_flat_ground_returned(tmp_path: Path) -> None:
    """It has one range, as far as the ground is flat and the sensor level."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, 300, endpoint=False), -np.deg2rad(np.arange(2.0, 18.0, 2.0))
    )
    flat = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1).reshape(-1, 3)
    ground = flat * 1.5 / -flat[:, 2:]
    points, iteration = np.tile(ground, (5, 1)), np.repeat(np.arange(5), len(ground))
    file = npz(tmp_path / "scans.npz", points=points, iteration=iteration, stamps_s=np.arange(5.0))
    assert {len(scan.points_robot) for scan in open_scans(file).scans()} == {len(ground)}


@pytest.mark.parametrize("around_rad", [0.3, np.pi])
def test_a_wall_at_the_largest_range_keeps_its_beams(tmp_path: Path, around_rad: float) -> None:
    """A sensor with a narrow view follows a wall, or one drives across a round room."""
    rng = np.random.default_rng(0)
    bearings = np.linspace(-around_rad / 2, around_rad / 2, 180)
    scans = []
    for step in np.linspace(-1, 1, 40):
        across = step * np.sin(bearings)
        round_m = np.sqrt(REACH_M**2 - step**2 + across**2) - step * np.cos(bearings)
        ranges = round_m if around_rad == np.pi else 3 / np.cos(bearings)
        scans.append(np.asarray(ranges + rng.normal(0, 0.01, 180)))
    kept = usable_beams(tmp_path / "a.log", scans, [bearings] * 40)[0]
    assert all(beams.all() for beams in kept)


def test_points_at_the_origin_did_not_return(tmp_path: Path) -> None:
    scans = [hall(step) for step in range(10)]
    for ranges in scans:
        ranges[40:60] = 0.0
    log = scans_npz(tmp_path, scans)
    assert {len(scan.points_robot) for scan in log.scans()} == {160}


@pytest.mark.parametrize("written", [scans_npz, carmen_log])
@pytest.mark.parametrize("range_m", [0.3, 0.8])
def test_beams_on_the_robot_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, written: Written, range_m: float
) -> None:
    rng = np.random.default_rng(0)
    mast = slice(20, 35)
    scans = [hall(step) for step in range(60)]
    for ranges in scans:
        ranges[mast] = (range_m + rng.normal(0, 0.02, 15)).round(3)
    log = written(tmp_path, scans)
    for scan, ranges in zip(log.scans(), scans, strict=True):
        assert np.hypot(*scan.points_robot.T) == pytest.approx(np.delete(ranges, mast), rel=1e-6)
    (message,) = caplog.messages
    where = "on the robot itself, or on what it pushes,"
    assert message.endswith(f"8.33 % of the beams end {where} and are left out")


def test_some_scans_of_a_long_log_show_the_parts_of_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans = [hall(step) for step in range(60)]
    for ranges in scans:
        ranges[20:35] = 0.3
    every = carmen_log(tmp_path, scans)
    monkeypatch.setattr(laser, "MOST", 21)
    some = carmen_log(tmp_path, scans)
    for one, other in zip(every.scans(), some.scans(), strict=True):
        assert len(one.points_robot) == 180 - 15
        np.testing.assert_array_equal(one.points_robot, other.points_robot)


def test_a_robot_that_stands_near_a_wall_keeps_its_beams(tmp_path: Path) -> None:
    near = np.minimum(hall(0), 0.5 / np.maximum(np.sin(BEARINGS), 1e-3))
    log = carmen_log(tmp_path, [near.round(3)] * 60)
    assert {len(scan.points_robot) for scan in log.scans()} == {180}


def test_if_no_other_beams_tell_that_the_robot_moves_none_are_on_it() -> None:
    own = on_robot(Path("a.log"), [np.full(180, 0.5)] * 60, [BEARINGS] * 60)
    assert not np.any(own)


def test_only_directions_off_the_robot_show_that_it_moves() -> None:
    """A tenth of these changes, but less of all directions."""
    rng = np.random.default_rng(0)
    ranges_m = [np.full(180, 3.0) for _ in range(60)]
    for ranges in ranges_m:
        ranges[60:120], ranges[:14] = 0.8, rng.uniform(1.0, 5.0, 14)
    own = on_robot(Path("a.log"), ranges_m, [BEARINGS] * 60)
    assert all(beams[60:120].all() and beams.sum() == 60 for beams in own)


def test_a_cart_that_is_pushed_down_a_corridor_is_left_out(tmp_path: Path) -> None:
    """Beside it the walls stay at the same range for most of the way."""
    scans = []
    for step in range(60):
        beside_m = (1.1 if step % 3 else 3.0) / np.maximum(np.abs(np.sin(BEARINGS)), 1e-3)
        scans.append(np.minimum(hall(step), beside_m).round(3))
        scans[-1][60:120] = 0.8
    log = carmen_log(tmp_path, scans)
    assert {len(scan.points_robot) for scan in log.scans()} == {120}


def test_a_wall_that_the_robot_follows_keeps_its_beams(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scans = [hall(step) for step in range(60)]
    for ranges in scans:
        beside_m = 0.3 + rng.normal(0, 0.02)
        ranges[:90] = np.minimum(ranges[:90], beside_m / np.maximum(-np.sin(BEARINGS[:90]), 1e-3))
    log = carmen_log(tmp_path, [ranges.round(3) for ranges in scans])
    assert {len(scan.points_robot) for scan in log.scans()} == {180}


def test_clouds_with_all_points_at_the_origin_are_opened(tmp_path: Path) -> None:
    content = "ply\nformat ascii 1.0\nelement vertex 40\n"
    content += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    for k in range(3):
        put(tmp_path, content + "0 0 0\n" * 40, f"{k}.ply")
    assert [len(scan.points_robot) for scan in open_scans(tmp_path).scans()] == [40] * 3


@pytest.mark.parametrize("written", [scans_npz, carmen_log])
def test_a_log_without_any_return_is_opened(tmp_path: Path, written: Written) -> None:
    log = written(tmp_path, [np.full(180, REACH_M)] * 30)
    assert sum(len(scan.points_robot) for scan in log.scans()) == 0


def test_rounded_echoes_of_a_beam_are_one_direction() -> None:
    rng = np.random.default_rng(0)
    bearings = np.repeat(BEARINGS, 3)
    bearings_rad = [bearings + rng.normal(0, 1e-8, len(bearings)) for _ in range(30)]
    ranges_m = [rng.uniform(1, 8, len(bearings)) for _ in range(30)]
    for ranges in ranges_m:
        ranges[60:105] = 0.3
    tracemalloc.start()
    own = on_robot(Path("a.npz"), ranges_m, bearings_rad)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert all(beams[60:105].all() and beams.sum() == 45 for beams in own)
    assert peak < 50e6
