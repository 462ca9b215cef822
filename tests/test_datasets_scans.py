"""Logs of point scans: our own, recognition, parts, damage, and the relations."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relmap.core.errors import RelmapError
from relmap.datasets import (
    SCAN_DATASETS,
    SCAN_FORMATS,
    open_log,
    open_scans,
    read_relations,
    write_scans_npz,
)
from tests.logs import put
from tests.scanlogs import CORRECTED, GRAPH, LASER, failure, npz, points_of


def test_formats_are_named() -> None:
    assert SCAN_FORMATS[:4] == ("scans-npz", "carmen-log", "mrpt-laser2d", "point-clouds")
    assert SCAN_FORMATS[4:] == ("bag-scans", "kitti-bin", "depth-images", "tum-rgbd")
    assert len({dataset.description for dataset in SCAN_DATASETS}) == len(SCAN_DATASETS)


@given(
    counts=st.lists(st.integers(0, 4), min_size=1, max_size=6).filter(any),
    columns=st.sampled_from([2, 3]),
    seed=st.integers(0, 99),
)
def test_written_values_are_read_back_exactly(
    folder: Path, counts: list[int], columns: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    scans = [rng.normal(size=(count, columns)) for count in counts]
    stamps_s = np.cumsum(rng.uniform(0.1, 1, len(counts)))
    write_scans_npz(folder / "scans.npz", scans, stamps_s)
    for path in (folder / "scans.npz", folder):
        log = open_scans(path)
        assert log.dimension == columns
        assert len(log) == len(counts)
        for number, scan in enumerate(log.scans()):
            assert scan.iteration == number
            assert scan.points_robot.tobytes() == scans[number].tobytes()
            assert scan.stamp_s == stamps_s[number]
            assert scan.T_reference_robot is None
    assert [path.name for path in folder.iterdir()] == ["scans.npz"]


def test_limits_of_the_sensor_must_be_positive_numbers(tmp_path: Path) -> None:
    log = open_scans(npz(tmp_path / "scans.npz", view_rad=np.float64(2.0)))
    assert (log.sensor.view_rad, log.sensor.range_m) == (2.0, None)
    for wrong in (np.array([2.0]), np.float64(0.0), np.float64(np.nan), np.array("far")):
        message = failure(npz(tmp_path / "scans.npz", range_m=wrong))
        assert "array range_m" in message
        assert "expected one positive number" in message
    degrees = failure(npz(tmp_path / "scans.npz", view_rad=np.float64(180)))
    assert "array view_rad: 180, expected radians" in degrees
    assert open_scans(npz(tmp_path / "scans.npz", view_rad=np.float32(2 * np.pi)))


@pytest.mark.parametrize(
    ("axes", "view_rad", "share"),
    [([0, 1], np.pi, None), ([1, 0], np.pi, "33.3 %"), ([0, 1], 1.0, "66.7 %"), ([1, 0], 6, None)],
)
def test_the_view_of_a_laser_holds_its_points(
    tmp_path: Path, axes: list[int], view_rad: float, share: str | None
) -> None:
    points = np.array([[1.0, 1.0], [2.0, 0.0], [1.0, -1.0]])[:, axes]
    path = npz(tmp_path / "scans.npz", points=points, view_rad=np.float64(view_rad))
    if share is None:
        assert open_scans(path).sensor.view_rad == view_rad
        return
    said = f"array view_rad: {view_rad:g}, but {share} of the points are outside of it, expected x"
    assert said in failure(path)


def test_the_range_of_the_sensor_reaches_its_points(tmp_path: Path) -> None:
    assert open_scans(npz(tmp_path / "scans.npz", range_m=np.float64(9)))
    near = failure(npz(tmp_path / "scans.npz", range_m=np.float64(1)))
    assert "array range_m: 1, but there are points up to 9.22 m away" in near


def test_a_log_in_which_every_z_is_zero_is_of_a_2d_laser(tmp_path: Path) -> None:
    points = np.arange(9.0).reshape(3, 3) * [1, 1, 0]
    log = open_scans(npz(tmp_path / "scans.npz", points=points))
    assert log.dimension == 2
    assert points_of(log)[0] == points[:2, :2].tolist()


def test_scans_come_in_the_order_of_time(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = npz(tmp_path / "a.npz", stamps_s=np.array([3.0, 1.0, 2.0]))
    log = open_scans(path)
    assert log.stamps_s.tolist() == [1, 2, 3]
    assert points_of(log) == [[[6, 7, 8]], [], [[0, 1, 2], [3, 4, 5]]]
    assert caplog.messages == [f"{path}: 2 scans out of order: all are sorted by time"]


@pytest.mark.parametrize("degrees", [False, True])
@pytest.mark.parametrize("which", ["range and bearing", "bearing and range", "x and y"])
def test_ranges_and_bearings_for_coordinates_are_noticed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, which: str, degrees: bool
) -> None:
    bearing = np.tile(np.linspace(-1.5, 1.5, 61), 2)
    range_m = 2.0 / np.maximum(np.abs(np.sin(bearing)), 0.3)  # a corridor
    polar = np.column_stack([range_m, np.rad2deg(bearing) if degrees else bearing])
    points = polar[:, ::-1] if which == "bearing and range" else polar
    if which == "x and y":
        points = range_m[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    open_scans(npz(tmp_path / "scans.npz", points=points, iteration=np.repeat([0, 1], 61)))
    found = [text for text in caplog.messages if "expected x (ahead) and y (left)" in text]
    assert len(found) == (which != "x and y")
    assert all(f"the points look like {which}" in text for text in found)


@pytest.mark.parametrize("d", [2, 3])
def test_points_in_a_distant_frame_are_refused(tmp_path: Path, d: int) -> None:
    away = np.array([447_123.5, 5_412_345.25, 120.0])
    points = np.random.default_rng(0).uniform(0, 8, (90, d)) + away[:d]
    path = npz(tmp_path / "scans.npz", points=points, iteration=np.repeat([0, 1], 45))
    assert "no point is nearer than 5.431e+06 m, expected metres, in the frame" in failure(path)


def test_rows_may_come_in_any_order_and_as_float32(tmp_path: Path) -> None:
    points = np.arange(9, dtype=np.float32).reshape(3, 3)
    path = npz(tmp_path / "a.npz", points=points, iteration=np.array([1, 0, 1]))
    assert points_of(open_scans(path)) == [[[3, 4, 5]], [[0, 1, 2], [6, 7, 8]]]
    assert open_scans(path).points_of(0).dtype == np.float64


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"points": None}, r"points\.npy"),
        ({"stamps_s": None}, r"stamps_s\.npy"),
        ({"points": np.zeros((3, 4))}, r"array points: float64 \(3, 4\)"),
        ({"points": np.zeros((0, 3)), "iteration": np.zeros(0, int)}, "at least one point"),
        ({"points": np.array(3.0)}, "array points"),
        ({"points": np.zeros((3, 3), dtype=complex)}, "array points: complex"),
        ({"points": np.array([[0, 0, 0], [0, np.nan, 0], [0, 0, 0]])}, "points, row 1: is not fin"),
        ({"points": np.full((3, 3), 1e12)}, "row 0: is not finite or out of range"),
        ({"points": np.full((3, 3), np.inf, np.float16)}, "row 0: is not finite or out of range"),
        ({"iteration": np.zeros(3)}, r"array iteration: float64 \(3,\), expected whole numbers"),
        (
            {"iteration": np.zeros(2, int)},
            r"array iteration: int64 \(2,\), expected .* \(3,\), one",
        ),
        ({"iteration": np.array([0, 1, 2])}, "iteration, row 2: is not a scan, expected 0 to 1"),
        ({"iteration": np.array([0, -1, 1])}, "iteration, row 1"),
        ({"stamps_s": np.array([1.0, 1.0])}, "stamps_s, row 1: is not a later time"),
        ({"stamps_s": np.array([np.nan, 1.0])}, "stamps_s, row 0"),
        (
            {"stamps_s": np.array([1, 17 * 10**17])},
            "stamps_s, row 1: is out of range, expected sec",
        ),
        ({"stamps_s": np.array([1.0, 0.0, 1.0])}, "stamps_s, row 2: is not a later time"),
        ({"stamps_s": np.zeros((2, 1))}, "array stamps_s"),
        (
            {"stamps_s": np.array([object(), 1], dtype=object)},
            "Object arrays cannot be loaded",
        ),
    ],
)
def test_damaged_arrays(tmp_path: Path, changes: dict[str, object], expected: str) -> None:
    with pytest.raises(RelmapError, match=expected):
        open_scans(npz(tmp_path / "scans.npz", **changes))


def test_cut_short_or_foreign_npz(tmp_path: Path) -> None:
    whole = npz(tmp_path / "scans.npz").read_bytes()
    for size in (4, 30, len(whole) // 2, len(whole) - 1):
        cut = tmp_path / "cut.npz"
        cut.write_bytes(whole[:size])
        assert "cut.npz: cannot be read" in failure(cut)
    flipped = bytearray(whole)
    flipped[200] ^= 0xFF
    (tmp_path / "cut.npz").write_bytes(flipped)
    assert "cut.npz: cannot be read" in failure(tmp_path / "cut.npz")
    assert "cannot be read" in failure(put(tmp_path, "text\n", "text.npz"), "scans-npz")
    (tmp_path / "scans.npz").unlink()
    assert "does not exist" in failure(tmp_path, "scans-npz")


@pytest.mark.parametrize(
    ("content", "format"),
    [(CORRECTED, "carmen-log"), (GRAPH, "carmen-log"), (LASER, "mrpt-laser2d")],
)
def test_recognised_by_content_whatever_the_name(tmp_path: Path, content: str, format: str) -> None:
    for name in ("a.log", "scans.npz", "x.csv.gz", "observations.csv"):
        path = put(tmp_path, content, name)
        assert points_of(open_scans(path)) == points_of(open_scans(path, format))
        with pytest.raises(RelmapError, match=rf"is a log of point scans \({format}\), expected"):
            open_log(path)


def test_other_things_are_refused(tmp_path: Path) -> None:
    assert "does not exist" in failure(tmp_path / "nothing")
    assert "format 'csv' is not known, expected scans-npz" in failure(tmp_path, "csv")
    message = failure(tmp_path)
    for dataset in SCAN_DATASETS:
        assert f"{dataset.name}: {dataset.description}" in message
    path = put(tmp_path, "iteration,x,y\n0,1,2\n", "observations.csv")
    for place in (path, tmp_path):
        assert "is a landmark log (observation-csv), expected a log of point" in failure(place)
    assert "line 1: 'hello' does not start a log of point scans" in failure(
        put(tmp_path, "hello\n", "a")
    )
    assert "is empty" in failure(put(tmp_path, "", "b"))
    (tmp_path / "c").write_bytes(struct.pack("<4d", 1, 2, 3, 4))
    assert "NUL byte" in failure(tmp_path / "c")


def test_a_part_of_a_log(tmp_path: Path) -> None:
    log = open_scans(put(tmp_path, CORRECTED, "a.log"))
    part = log.between(1, 9)
    assert [(scan.iteration, scan.stamp_s) for scan in part.scans()] == [(1, 5.5)]
    assert points_of(part) == points_of(log)[1:]
    assert part.poses.shape == (1, 4, 4)
    assert points_of(part.between(0, 2)) == points_of(part)
    with pytest.raises(RelmapError, match="scans 2:5 are empty: the log covers 0:2"):
        log.between(2, 5)


def test_relations(tmp_path: Path) -> None:
    path = put(tmp_path, f"# t1 t2\n1 2 3 4 5 0 0 {np.pi / 2}\n\n2 3 0 0 0 {np.pi} 0 0\n", "a")
    relations = read_relations(path)
    assert relations.begin_s.tolist() == [1, 2]
    assert relations.end_s.tolist() == [2, 3]
    expected = [[0, -1, 0, 3], [1, 0, 0, 4], [0, 0, 1, 5], [0, 0, 0, 1]]
    np.testing.assert_allclose(relations.T_begin_end[0], expected, atol=1e-12)
    np.testing.assert_allclose(np.diag(relations.T_begin_end[1]), [1, -1, -1, 1], atol=1e-12)
    for text, expected_text in (
        ("1 2 3\n", "line 1: '1 2 3', expected 8 numbers"),
        ("1 2 3 4 5 6 7 nan\n", "line 1"),
        ("1 2 3 4 5 6 7 x\n", "line 1"),
        ("# none\n", "holds no relation"),
    ):
        with pytest.raises(RelmapError, match=expected_text):
            read_relations(put(tmp_path, text, "b"))
