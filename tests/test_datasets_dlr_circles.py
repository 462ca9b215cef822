"""DLR's circles in small: read, refused, mutated."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest

from relmap.core.errors import RelmapError
from relmap.datasets import open_log
from relmap.datasets.dlr_circles import DlrCircles, read_ids
from tests.logs import failure, put

HEAD = "# A header of comments.\n#  LANDMARK <pX> <pY> ...\n \n"
STEP = "STEP image.0000 0.001 -0.15 0.01 1e-5 0 1e-5 2e-5 0 2e-4\r\n"
CIRCLES = (
    HEAD
    + STEP
    + "LANDMARK_C -0.25 -3.0 0.93 0.0017 0.0001 0.0037 6\r\n"
    + "LANDMARK_C 0.5 -2.0 0.82 0.0017 0.0001 0.0037 -1\r\n"
    + "LANDMARK_C 0.75 -2.0 0.82 0.0017 0.0001 0.0037 -1\r\n"
    + STEP * 2
    + "LANDMARK 0.5 -1.0 0.82 0.0017 0.0001 0.0037 4 6\r\n"
    + "\r\nLANDMARK_C 1 -2.5 0.93 0.0017 0.0001 0.0037 6\r\n"
    + STEP
)


def test_steps_are_iterations_and_axes_are_ours(tmp_path: Path) -> None:
    for content, name in ((CIRCLES, "a.circles"), (gzip.compress(CIRCLES.encode()), "b.txt")):
        log = open_log(put(tmp_path, content, name))
        assert (log.first_iteration, log.end_iteration) == (0, 4)
        assert log.iteration.tolist() == [0, 0, 0, 2, 2]
        ahead_left = [[3, 0.25], [2, -0.5], [2, -0.75], [1, -0.5], [2.5, -1]]
        assert log.points_robot.tolist() == ahead_left
        assert log.ids.tolist() == [6, -1, -1, -1, 6]
        assert [len(scan.rows) for scan in log.scans()] == [3, 0, 2, 0]


def test_folder(tmp_path: Path) -> None:
    put(tmp_path, "hello", "other.circles")
    path = put(tmp_path, gzip.compress(CIRCLES.encode()), "map.circles.gz")
    assert DlrCircles().recognises(tmp_path)
    assert len(open_log(tmp_path).rows) == 5
    assert read_ids(tmp_path).tolist() == read_ids(path).tolist() == [6]
    put(tmp_path, CIRCLES, "again.circles")
    message = failure(tmp_path, "dlr-circles")
    assert "holds 2 circle logs, expected one of again.circles, map.c" in message
    (tmp_path / "empty").mkdir()
    assert "holds no circle log, expected one *.circles" in failure(
        tmp_path / "empty", "dlr-circles"
    )


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("STEP image.0000", "STEP", "line 4: 'STEP 0.001 -0.15"),
        ("0.01 1e-5", "0.01 nan", "line 4: 'STEP .*expected finite numbers: STEP image dX"),
        ("-0.25 -3.0", "-0.25 -3,0", "line 5: .*expected finite numbers: LANDMARK_C pX pY"),
        ("-0.25 -3.0", "-3.0", "line 5: .*expected finite numbers: LANDMARK_C pX pY"),
        ("-0.25 -3.0", "2e9 -3.0", "line 5, field pX: 2000000000 is out of range, expected a num"),
        ("0.0037 -1", "0.0037 6", "line 6, field id: 6 occurs twice .* .before in line 5., exp"),
        ("0.0037 6", "0.0037 6.5", "line 5, field id: 6.5 is not an integer, expected an integer"),
        ("LANDMARK 0.5", "LANDMARK_L 0.5", "line 10: .* begins with neither STEP nor LANDMARK_C"),
        ("LANDMARK 0.5", "LANDMARK_C\udcff 0.5", "line 10: byte 0xff is not UTF-8"),
        (STEP, "", "line 4: 'LANDMARK_C -0.25 .* comes before the first step, expected STEP"),
        ("LANDMARK", "# LANDMARK", "map.circles: holds no circle, expected lines LANDMARK_C pX"),
    ],
)
def test_bad_content(tmp_path: Path, old: str, new: str, problem: str) -> None:
    content = CIRCLES.replace(old, new).encode("utf-8", "surrogateescape")
    path = put(tmp_path, content, "map.circles")
    with pytest.raises(RelmapError, match=problem):
        open_log(path, "dlr-circles")
    assert "map.circles" in failure(path, "dlr-circles")


def test_pipe_in_a_folder_is_not_a_log(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "map.circles")
    assert not DlrCircles().recognises(tmp_path)
