"""Iterations are sorted by time, and rows of `odometry.csv` follow them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from relmap.datasets import open_log, open_scans
from tests.logs import failure, put


@pytest.mark.parametrize(("step", "n"), [(10, 5), (1, 5), (10, 4)])
def test_numbers_that_leave_out_iterations_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, step: int, n: int
) -> None:
    path = put(tmp_path, "iteration,x,y\n" + "".join(f"{step * k},1,2\n" for k in range(n)))
    assert len(open_log(path)) == step * (n - 1) + 1
    warnings = [f"{path}: iterations are numbered 0, 10, 20, ...: those between count as scans in "]
    warned = step > 1 and n >= 5
    assert [text[: len(warnings[0])] for text in caplog.messages] == warnings * warned


def test_scans_out_of_order_are_sorted_by_time(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = "iteration,x,y,stamp\n0,1,1,5\n2,2,2,4\n2,3,3,4.1\n7,4,4,6\n"
    path = put(tmp_path, rows)
    log = open_log(path)
    assert log.points_robot[:, 0].tolist() == [2, 3, 1, 4]
    assert log.iteration.tolist() == [0, 0, 5, 7]
    assert log.rows.tolist() == [1, 2, 0, 3]
    assert log.stamps_s[[0, 5, 7]].tolist() == [4, 5, 6]
    assert caplog.messages == [f"{path}: 1 scans out of order: all are sorted by time"]


def test_an_iteration_does_not_last_into_another_one(tmp_path: Path) -> None:
    rows = "iteration,x,y,stamp\n0,1,1,5\n1,2,2,6\n0,3,3,6.5\n0,3,3,7\n"
    assert "line 4, field stamp: 6.5 is later than" in failure(put(tmp_path, rows))


@pytest.mark.parametrize(("begin", "used"), [(3, [1, 1, 0, 1, 1]), (0, [1] * 5)])
def test_motions_follow_scans_that_are_sorted_by_time(
    tmp_path: Path, begin: int, used: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    number = np.roll(np.arange(6), -begin)  # in order of time: 3, 4, 5, 0, 1, 2
    rows = [f"{number[k]},{10 + k},1,2" for k in range(6) if number[k] not in (1, 4)]
    put(tmp_path, "iteration,stamp,x,y\n" + "\n".join(rows), "observations.csv")
    motion = [f"{k},{k},0,0" for k in range(6)]
    put(tmp_path, "iteration,x,y,yaw\n" + "\n".join(motion), "odometry.csv")
    found = open_log(tmp_path).odometry[1:, 0, 3]
    assert_array_equal(found, np.where(used, number[1:], np.nan))
    told = "odometry.csv: 1 motions are not used: sorted by time, their scans follow others"
    assert (told in caplog.text) == (begin > 0)


def test_motions_follow_scans_though_the_last_iterations_have_no_rows(tmp_path: Path) -> None:
    put(tmp_path, "iteration,stamp,x,y\n3,1,1,2\n0,2,1,2", "observations.csv")
    put(tmp_path, "iteration,x,y,yaw\n0,5,0,0\n1,6,0,0\n3,7,0,0", "odometry.csv")
    log = open_log(tmp_path)
    assert_array_equal(log.numbers, [3, 0])
    assert_array_equal(open_log(tmp_path).odometry[:, 0, 3], [7, np.nan])


def scans_npz(folder: Path, stamps_s: list[float]) -> Path:
    points, iteration = np.ones((len(stamps_s), 3)), np.arange(len(stamps_s))
    np.savez(folder / "scans.npz", points=points, iteration=iteration, stamps_s=stamps_s)
    return folder


def carmen_log(folder: Path, stamps_s: list[float]) -> Path:
    ranges = " ".join(f"{2 + 0.01 * k:.2f}" for k in range(180))
    lines = [f"FLASER 180 {ranges} {t} 0 0 {t} 0 0 {t} host {t}" for t in stamps_s]
    return put(folder, "\n".join(lines), "a.log")


@pytest.mark.parametrize("written", [scans_npz, carmen_log])
def test_motions_follow_scans_of_points_that_are_sorted_by_time(
    tmp_path: Path, written: Callable[[Path, list[float]], Path]
) -> None:
    path = written(tmp_path, [4.0, 5, 1, 2, 3])
    motion = [f"{k},{k},0,0" for k in range(5)]
    put(tmp_path, "iteration,x,y,yaw\n" + "\n".join(motion), "odometry.csv")
    odometry = open_scans(path).odometry
    assert_array_equal(odometry[1:, 0, 3], [3, 4, np.nan, 1])


def test_a_motion_from_another_iteration_than_the_one_before_is_unknown(tmp_path: Path) -> None:
    put(tmp_path, "iteration,x,y,stamp\n0,1,1,0\n1,1,1,2\n2,1,1,1\n3,1,1,3\n", "observations.csv")
    put(tmp_path, "iteration,x,y,yaw\n1,5,0,0\n2,6,0,0\n3,7,0,0", "odometry.csv")
    assert_array_equal(open_log(tmp_path).odometry[:, 0, 3], [np.nan] * 4)


def test_the_time_of_an_iteration_is_its_earliest(tmp_path: Path) -> None:
    path = put(tmp_path, "iteration,x,y,stamp\n0,1,2,0.3\n0,2,2,0.1\n1,1,2,0.9\n")
    assert_array_equal(open_log(path).stamps_s, [0.1, 0.9])
