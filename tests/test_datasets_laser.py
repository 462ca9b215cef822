"""Logs of 2-D laser scans: CARMEN's and those of MRPT's simulator."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from relmap.datasets import open_scans
from relmap.datasets.scans import SensorView
from tests.logs import put
from tests.scanlogs import CORRECTED, GRAPH, LASER, LASER_COMMENT, LASER_HEADER, failure, points_of


def test_corrected_log(tmp_path: Path) -> None:
    log = open_scans(put(tmp_path, CORRECTED, "a.log"))
    assert log.dimension == 2
    assert log.stamps_s.tolist() == [4.5, 5.5]
    # Two beams of a half turn that leaves out its last one, three of a whole one; 81.8 is none.
    assert points_of(log) == [[[0, -3.5]], [[0, -1], [2, 0]]]
    np.testing.assert_allclose(log.poses[0, :2, 3], [1, 2])
    np.testing.assert_allclose(log.poses[0, :2, 0], [np.cos(0.5), np.sin(0.5)])


def test_a_folder_of_logs_names_them(tmp_path: Path) -> None:
    put(tmp_path, CORRECTED, "a.log")
    put(tmp_path, gzip.compress(CORRECTED.encode()), "b.log.gz")
    put(tmp_path, "something else", "c.log")
    expected = "holds 2 logs of CARMEN, expected the name of one of them: a.log, b.log.gz"
    assert failure(tmp_path).endswith(expected)


def test_full_scale_counts_only_where_it_is_reached(tmp_path: Path) -> None:
    text = CORRECTED.replace("81.91", "70")
    assert points_of(open_scans(put(tmp_path, text.replace("81.8", "60"), "a.log")))[1][2] == [
        0,
        60,
    ]
    assert len(points_of(open_scans(put(tmp_path, text, "a.log")))[1]) == 2


@pytest.mark.parametrize(
    ("n", "first_deg", "last_deg", "warns"),
    [
        (180, -90, 89, 0),
        (361, -90, 90, 0),
        (401, -50, 50, 0),
        (400, -50, 49.75, 0),
        (541, -90, 90, 1),
    ],
)
def test_the_view_of_a_laser_by_its_number_of_beams(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    n: int,
    first_deg: float,
    last_deg: float,
    warns: int,
) -> None:
    log = open_scans(put(tmp_path, f"FLASER {n} {'1 ' * n}1 2 0 1 2 0 4.5 host 9\n", "a.log"))
    (scan,) = log.scans()
    bearings_deg = np.rad2deg(np.arctan2(*scan.points_robot.T[1::-1]))
    np.testing.assert_allclose(bearings_deg[[0, -1]], [first_deg, last_deg])
    assert len(caplog.messages) == warns
    assert all(f"{n} beams are taken to cover 180 degrees" in one for one in caplog.messages)


def test_graph_log(tmp_path: Path) -> None:
    path = tmp_path / "a.log.gz"
    path.write_bytes(gzip.compress(GRAPH.encode()))
    log = open_scans(path)
    assert log.stamps_s.tolist() == [10.5, 11.5]
    first, second = (scan.points_robot for scan in log.scans())
    bearing = np.array([-1.5, -1.0])
    expected = np.array([1.0, 2.0])[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    np.testing.assert_allclose(first, expected + np.array([0.2, 0]))
    # The laser stands where the robot does, turned a little to the right; 0 is not a return.
    bearing = np.array([-1.5, -0.5]) + 1.5 - np.pi / 2
    expected = np.array([1.0, 49.0])[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    np.testing.assert_allclose(second, expected, atol=1e-12)
    np.testing.assert_allclose(log.poses[:, 0, 3], [7, 8])


@pytest.mark.parametrize("limit", ["0", "-1"])
def test_a_range_of_the_laser_that_is_not_above_zero_is_unknown(tmp_path: Path, limit: str) -> None:
    log = open_scans(put(tmp_path, GRAPH.replace("0.5 50 0.1", f"0.5 {limit} 0.1"), "a.log"))
    assert [len(scan.points_robot) for scan in log.scans()] == [3, 2]
    assert log.sensor.range_m is None


def test_a_log_without_vertices_gives_the_pose_of_its_scans(tmp_path: Path) -> None:
    text = "\n".join(line for line in GRAPH.splitlines() if line.startswith("ROBOT"))
    log = open_scans(put(tmp_path, text, "a.log"))
    np.testing.assert_allclose(log.poses[:, 0, 3], [0, 2])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("3.5 81.91 1", "3.5 1", "line 4: 'FLASER 2 3.5 1 2 0.5 1 2', expected FLASER n r1"),
        ("3.5", "nan", "'nan', expected FLASER n r1..rn"),
        ("3.5", "nan", "a beam without a return has the range 0 or the maximum range"),
        ("3.5", "inf", "a beam without a return has the range 0"),
        ("3.5", "3_5", "line 4: '3_5', expected FLASER"),
        ("3.5", "x", "line 4"),
        ("3.5", "1e10", "line 4: the range of beam 0"),
        ("FLASER 2", "FLASER 0", "line 4"),
        ("FLASER 2", "FLASER -2", "line 4"),
        ("FLASER 2", "FLASER 99999", "line 4"),
        ("FLASER 2", "FLASER \u0662", "line 4"),
        ("5.5 host 9\n", "5.5 ho", "line 6"),
        ("5.5 host 9\n", "", "host t: cut off after 11 of 14 fields"),
        ("FLASER 3 1 2 81.8 1 2 0.5 1 2 0.5 5.5 host 9\n", "FLASER", "cut off after field 1"),
        ("FLASER", "RLASER", "holds no scan, expected a CARMEN log"),
        ("5.5 host", "1.7e12 host", "scan 1 has the time 1.7e+12, expected seconds, at most"),
    ],
)
def test_damaged_carmen_log(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in failure(put(tmp_path, CORRECTED.replace(old, new), "a.log"), "carmen-log")


def test_only_of_ranges_it_is_said_what_no_return_is(tmp_path: Path) -> None:
    said = failure(put(tmp_path, CORRECTED.replace("1 2 0.5 1 2", "1 nan 0.5 1 2"), "a.log"))
    assert "'nan', expected FLASER" in said
    assert "without a return" not in said


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0 3 1 2 60 0", "0 3 1 2 60 1"),
        ("0 3 1 2 60 0", "0 3 1 2"),
        ("-1.5 3", "- 3"),
        ("-1.5 3", "-90 180"),
    ],
)
def test_damaged_graph_log(tmp_path: Path, old: str, new: str) -> None:
    message = failure(put(tmp_path, GRAPH.replace(old, new, 1), "a.log"))
    assert "line 2" in message
    assert "expected ROBOTLASER1" in message


def test_cut_gzip(tmp_path: Path) -> None:
    data = gzip.compress(GRAPH.encode() * 50)
    (tmp_path / "a.log.gz").write_bytes(data[: len(data) // 2])
    assert "damaged gzip" in failure(tmp_path / "a.log.gz", "carmen-log")


def test_with_a_constant_clock_scans_are_numbered(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = put(tmp_path, CORRECTED.replace("5.5 host", "4.5 host"), "a.log")
    assert open_scans(path).stamps_s.tolist() == [0, 1]
    assert "times repeat" in caplog.text


def test_mrpt_laser(tmp_path: Path) -> None:
    path = put(tmp_path, LASER, "simul.scans.csv")
    for log in (open_scans(path), open_scans(tmp_path)):
        assert log.stamps_s.tolist() == [10, 11]
        assert points_of(log) == [[[0.2, -1], [2.2, 0], [0.2, 3]], [[0.2, -1], [0.2, 3]]]
        np.testing.assert_allclose(log.poses[1, :2, 3], [2, 2])
        assert log.sensor == SensorView(view_rad=np.pi, range_m=80.0, x_m=0.2)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (LASER_COMMENT, "", "no usable sensor"),
        ("x=0.2", "x=here", "no usable sensor"),
        ("max range 80", "max range -1", "no usable sensor"),
        ("gt_y,", "", "missing column gt_y"),
        ("r1", "r4", "unknown column 'r4'"),
        ("1,80,3", "1,80", "line 4: 9 fields"),
        ("1,80,3", "1,nan,3", "line 4, field r1: 'nan' is not finite"),
        ("1,80,3", "1,-1e10,3", "line 4, field r1"),
        ("11,2", "-9,2", "line 4, field t_s"),
    ],
)
def test_damaged_mrpt_laser(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in failure(put(tmp_path, LASER.replace(old, new), "a.csv"), "mrpt-laser2d")


def test_messages_do_not_list_hundreds_of_beams(tmp_path: Path) -> None:
    beams = ",".join(f"r{k}" for k in range(361))
    path = put(tmp_path, f"{LASER_COMMENT}{LASER_HEADER.replace('r0,r1,r2', beams)}1,2\n", "a.csv")
    assert "expected 368: t_s,gt_x" in failure(path)


@pytest.mark.parametrize(
    ("text", "old", "new"),
    [(CORRECTED, "81.8 ", "-1 "), (GRAPH, "60 0 0.2", "-1 0 0.2"), (LASER, "1,80,3", "1,-1,3")],
)
def test_a_range_below_zero_is_not_a_return(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, text: str, old: str, new: str
) -> None:
    whole = points_of(open_scans(put(tmp_path, text, "whole")))
    path = put(tmp_path, text.replace(old, new, 1), "errors")
    assert points_of(open_scans(path)) == whole
    assert caplog.messages == [f"{path}: 1 ranges below 0 are treated as no return"]


@pytest.mark.parametrize(("text", "cut"), [(CORRECTED, "FLASER"), (GRAPH, "VERTEX2"), (LASER, "1")])
def test_scans_come_in_the_order_of_time(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, text: str, cut: str
) -> None:
    """Of one log the first scan is put behind the second, with its pose."""
    parts = re.fullmatch(f"(?ms)(.*?)(^{cut}.*?)(^{cut}.*)", text)
    head, first, second = parts.groups()
    ordered = open_scans(put(tmp_path, text, "ordered"))
    path = put(tmp_path, head + second + first, "mixed")
    mixed = open_scans(path)
    assert caplog.messages == [f"{path}: 1 scans out of order: all are sorted by time"]
    assert mixed.stamps_s.tolist() == ordered.stamps_s.tolist()
    assert points_of(mixed) == points_of(ordered)
    np.testing.assert_array_equal(mixed.poses, ordered.poses)
