"""I-SLSJF's simulation in small: log and truth, read, refused, mutated."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets import open_log
from relmap.datasets.slsjf import (
    BEACONS_FILE,
    LOG_FILE,
    ROBOT_FILE,
    SlsjfSimulation,
    is_ground_truth,
    read_ground_truth,
)
from tests.logs import one_line_error

SEEN = np.array(
    [
        [1.0, 7, 2, np.pi / 2, 0, 0, 0],
        [1, 9, 3, -4 * np.pi, 0, 0, 0],
        [3, 9, -0.01, 0, 0, 0, 0],
        [3, 7, 1, np.pi, 0, 0, 0],
        [2, 7, 1, 0, 0, 0, 0],
    ]
)
BEACONS = np.array([[7, 1, 2], [9, 4, 5], [11, 6, 7]], dtype=np.uint16)
ROBOT = np.array([[0.0, 1, 2, 3], [0, 0, 0, 1], [0, np.pi / 2, 5 * np.pi / 2, 0]])


def put(folder: Path, file: str, matrix: Floats | NDArray[np.uint16]) -> Path:
    """Write a MATLAB file with the variable that the reader looks for."""
    savemat(folder / file, {Path(file).stem: matrix})
    return folder / file


def failure(path: Path, truth: bool = False) -> str:
    """Return the one-line error of reading."""
    read = read_ground_truth if truth else partial(open_log, format="slsjf-sim")
    return one_line_error(read, path)


def test_log(tmp_path: Path) -> None:
    file = put(tmp_path, LOG_FILE, SEEN)
    for path in (tmp_path, file):
        log = open_log(path)
        assert (log.first_iteration, log.end_iteration) == (0, 3)
        assert log.iteration.tolist() == [0, 0, 1, 2]
        assert log.rows.tolist() == [0, 1, 4, 3]
        assert np.allclose(log.points_robot, [[0, 2], [3, 0], [1, 0], [-1, 0]])
        assert log.ids.tolist() == [7, 9, 7, 7]


def test_truth(tmp_path: Path) -> None:
    assert not is_ground_truth(tmp_path)
    put(tmp_path, BEACONS_FILE, BEACONS)
    put(tmp_path, ROBOT_FILE, ROBOT)
    for path in (tmp_path, tmp_path / BEACONS_FILE, str(tmp_path / LOG_FILE)):
        ids, positions, poses = read_ground_truth(path)
        assert ids.tolist() == [7, 9, 11]
        assert positions.tolist() == [[1, 2, 0], [4, 5, 0], [6, 7, 0]]
        assert poses.shape == (4, 4, 4)
        assert np.allclose(poses[1:3] @ [1, 0, 0, 1], [[1, 1, 0, 1], [2, 1, 0, 1]])
    assert is_ground_truth(tmp_path)
    assert is_ground_truth(tmp_path / ROBOT_FILE)
    (tmp_path / ROBOT_FILE).unlink()
    assert f"{ROBOT_FILE}: cannot be read" in failure(tmp_path, truth=True)


@pytest.mark.parametrize(
    ("row", "column", "value", "problem"),
    [
        (0, 0, 0, "row 1, field step: 0 is out of range, expected an integer from 1 to"),
        (1, 0, 1.5, "row 2, field step: 1.5 is not an integer"),
        (2, 1, np.nan, "row 3, field id: nan is not finite"),
        (1, 1, 7, "row 2, field id: 7 occurs twice in iteration 0 (before in row 1), expected"),
        (3, 2, np.inf, "row 4, field range_m: inf is not finite, expected a number of metres"),
        (4, 3, 1e9, "row 5, field bearing_rad: 1000000000 is out of range"),
        (4, 0, 9e7, "row 5, field step: 89999999 comes after 2, and in all 89999997 iterations"),
        (slice(None), 2, -1, "row 1, field range_m: this and every other range is negative"),
    ],
)
def test_bad_rows(
    tmp_path: Path, row: int | slice, column: int, value: float, problem: str
) -> None:
    matrix = SEEN.copy()
    matrix[row, column] = value
    message = failure(put(tmp_path, LOG_FILE, matrix))
    assert f"{LOG_FILE}: {problem}" in message


def test_other_matrices(tmp_path: Path) -> None:
    path = put(tmp_path, LOG_FILE, SEEN[:, :4])
    assert "4 numbers per row, expected 7: step, id, range_m, bearing_rad, unused_5" in failure(
        path
    )
    path = put(tmp_path, ROBOT_FILE, ROBOT)
    with pytest.raises(RelmapError, match="expected a MATLAB file with sensor_data"):
        open_log(path)
    put(tmp_path, BEACONS_FILE, BEACONS[:, :2])
    assert "2 numbers per row, expected 3: id, x, y" in failure(tmp_path, truth=True)
    put(tmp_path, BEACONS_FILE, BEACONS)
    put(tmp_path, ROBOT_FILE, ROBOT.T)
    message = failure(tmp_path, truth=True)
    assert f"{ROBOT_FILE}: 4 numbers per column, expected 3: x, y, phi" in message
    put(tmp_path, ROBOT_FILE, ROBOT * [1, 1, np.nan, 1])
    assert f"{ROBOT_FILE}: column 3, field x: nan is not finite" in failure(tmp_path, truth=True)


def test_damaged_log(tmp_path: Path) -> None:
    path = put(tmp_path, LOG_FILE, SEEN)
    for content in (b"", b"rubbish", path.read_bytes()[:200]):
        path.write_bytes(content)
        assert f"{LOG_FILE}: cannot be read" in failure(tmp_path)


def test_folder_without_the_log(tmp_path: Path) -> None:
    assert not SlsjfSimulation().recognises(tmp_path)
    assert f"{LOG_FILE}: cannot be read" in failure(tmp_path)
    os.mkfifo(tmp_path / LOG_FILE)
    assert not SlsjfSimulation().recognises(tmp_path)
