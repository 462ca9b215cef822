"""Victoria Park in small: trees, clock and tree numbers, whole and damaged."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.datasets import open_log
from relmap.datasets.victoria_park import ASSOCIATION_FILE, CLOCK_FILE, read_reference_map
from tests.logs import TREES, failure, put

ASSOCIATED = np.array(
    [
        [300.0, 10.01, np.pi / 2, 1, 2, 40],
        [700.0, 5.01, np.pi, 3, 4, 40],
        [999.0, 5.0, np.pi, 5, 6, 50],
    ]
)


def put_mat(folder: Path, file: str, matrix: Floats) -> Path:
    """Write a MATLAB file with the variable that the reader looks for."""
    name = "TLsr" if file == CLOCK_FILE else Path(file).stem
    savemat(folder / file, {name: matrix})
    return folder / file


def test_victoria_park_alone(tmp_path: Path) -> None:
    log = open_log(put(tmp_path, TREES, "trees.csv"))
    assert np.allclose(log.points_robot, [[10, 0], [0, -5], [0, 5]])
    assert (log.first_iteration, log.end_iteration, log.ids) == (1, 4, None)
    assert np.allclose(log.stamps_s, [0.3, 0.5, 0.7])


def test_victoria_park_with_clock_and_association(tmp_path: Path) -> None:
    put(tmp_path, gzip.compress(TREES.encode()), "trees_per_scan.csv.gz")
    put_mat(tmp_path, CLOCK_FILE, np.array([[0.1, 0.3, 0.45, 0.7, 0.9]]))
    put_mat(tmp_path, ASSOCIATION_FILE, ASSOCIATED)
    log = open_log(tmp_path)
    assert (log.first_iteration, log.end_iteration) == (0, 5)
    assert log.stamps_s.tolist() == [0.1, 0.3, 0.45, 0.7, 0.9]
    assert log.ids.tolist() == [40, -1, 40]
    ids, positions = read_reference_map(tmp_path)
    assert ids.tolist() == [40, 50]
    assert positions.tolist() == [[3, 4, 0], [5, 6, 0]]
    assert np.array_equal(read_reference_map(tmp_path / ASSOCIATION_FILE)[1], positions)


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (TREES.replace("1,300,5", "1,301,5"), ["line 3, field t_ms", "differs within a scan"]),
        (TREES.replace("3,700", "3,300"), ["line 4, field t_ms", "does not increase"]),
        (TREES.replace("5,0,", "5,90,"), ["line 3, field bearing_rad", "radians"]),
        (TREES.replace("scan,", ""), ["line 1", "missing column scan"]),
    ],
)
def test_victoria_park_bad_trees(tmp_path: Path, content: str, parts: list[str]) -> None:
    message = failure(put(tmp_path, content, "trees.csv"))
    for part in ["trees.csv", *parts]:
        assert part in message


@pytest.mark.parametrize(
    ("file", "matrix", "problem"),
    [
        (CLOCK_FILE, [[0.1, 0.3]], "line 4, field t_ms: expected the scan's time as in Victoria"),
        (CLOCK_FILE, [[0.1, 0.2, 0.3, 0.7]], "line 2, field t_ms: expected the scan's time"),
        (CLOCK_FILE, [[0.1, 0.3, 0.2, 0.7]], "field TLsr: does not increase"),
        (CLOCK_FILE, [[0.1, 0.3, np.nan, 0.7]], "field TLsr: does not increase"),
        (CLOCK_FILE, [[]], "not a matrix of numbers"),
        (ASSOCIATION_FILE, ASSOCIATED[:, :5], "field data_sensor_clean_clean"),
        (ASSOCIATION_FILE, ASSOCIATED * np.nan, "field data_sensor_clean_clean"),
        (ASSOCIATION_FILE, ASSOCIATED + 0.5, "field data_sensor_clean_clean"),
        (ASSOCIATION_FILE, ASSOCIATED[2:], "does not fit the trees beside it .0 of 1 rows"),
        (ASSOCIATION_FILE, ASSOCIATED[[0, 0]], "does not fit the trees beside it .2 of 2 rows"),
    ],
)
def test_victoria_park_bad_mat(
    tmp_path: Path, file: str, matrix: list[list[float]], problem: str
) -> None:
    put(tmp_path, TREES, "trees.csv")
    put_mat(tmp_path, file, np.array(matrix))
    with pytest.raises(RelmapError, match=problem) as caught:
        open_log(tmp_path)
    assert str(caught.value).isprintable()


def test_victoria_park_damaged_mat(tmp_path: Path) -> None:
    put(tmp_path, TREES, "trees.csv")
    path = put_mat(tmp_path, ASSOCIATION_FILE, ASSOCIATED)
    whole = path.read_bytes()
    for content in (b"", b"rubbish", whole[:200]):
        path.write_bytes(content)
        assert f"{ASSOCIATION_FILE}: cannot be read" in failure(tmp_path)
    path.write_bytes(gzip.compress(whole, 1))
    assert "'packed by gzip'" in failure(tmp_path)
    savemat(path, {"other": ASSOCIATED})
    assert "expected a MATLAB file with data_sensor_clean_clean" in failure(tmp_path)
    with pytest.raises(RelmapError, match="cannot be read"):
        read_reference_map(tmp_path / "nowhere" / "x")
