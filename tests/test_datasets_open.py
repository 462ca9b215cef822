"""Recognition by content, the registry, and the readers of other people's formats."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from relmap.core.errors import RelmapError
from relmap.datasets import DATASETS, FORMATS, open_log
from relmap.datasets.mrpt_landmarks import is_ground_truth, read_ground_truth
from tests.logs import TREES, failure, put

POINTS = "iteration,x,y\n0,1,2\n"
SENSOR = "# sensor on robot: t = 0 0 0 ; R (row major) = 1 0 0 0 1 0 0 0 1\n"
SIGMA = "# sigma: range 0.01 m, yaw 0.001745 rad, pitch {} rad; max range 6 m\n"
HEADER = "step,id,range_m,yaw_rad,pitch_rad\n"
MRPT = SENSOR + SIGMA.format(0.001745) + HEADER + "0,3,2,0,0\n0,-1,2,1.5,0.1\n2,3,1,0,0\n"


def test_formats_are_named() -> None:
    assert FORMATS == (
        "observation-csv",
        "mrpt-landmarks",
        "victoria-park",
        "dlr-circles",
        "slsjf-sim",
        "mrclam",
        "own-table",
        "bag-detections",
    )
    assert len({dataset.description for dataset in DATASETS}) == len(DATASETS)


@pytest.mark.parametrize(
    ("content", "format"), list(zip([POINTS, MRPT, TREES], FORMATS[:3], strict=True))
)
def test_recognised_by_content_whatever_the_name(tmp_path: Path, content: str, format: str) -> None:
    for name in ("observations.csv", "trees_per_scan.csv.gz", "log.observations.csv.gz", "x.png"):
        path = put(tmp_path, content, name)
        assert [dataset.recognises(path) for dataset in DATASETS] == [f == format for f in FORMATS]
        assert np.array_equal(open_log(path).points_robot, open_log(path, format).points_robot)
        assert np.array_equal(open_log(str(path)).rows, open_log(path).rows)
    (tmp_path / "observations.csv").unlink()
    for name in ("trees_per_scan.csv.gz", "x.png"):
        (tmp_path / name).unlink()
    if format != "observation-csv":
        assert len(open_log(tmp_path).rows) == 3
        put(tmp_path, content, "another.csv")
        assert "another.csv, log.observations.csv.gz" in failure(tmp_path)


def test_missing_path_and_unknown_format(tmp_path: Path) -> None:
    assert "nothing: does not exist" in failure(tmp_path / "nothing")
    assert "does not exist" in failure(tmp_path / "nothing", "victoria-park")
    for message in (failure(put(tmp_path, POINTS, "log"), "csv\n"), failure("nothing", "csv")):
        assert "format 'csv' is not known, expected observation-csv, mrpt-" in message


def test_folder_without_a_log_and_folder_with_two(tmp_path: Path) -> None:
    put(tmp_path, "step,dx_m\n0,1\n", "wheels.csv")
    message = failure(tmp_path)
    assert str(tmp_path) in message
    for dataset in DATASETS:
        assert dataset.name in message
        assert dataset.description in message
    assert "expected one observations.csv or observations.csv.gz" in failure(
        tmp_path, "observation-csv"
    )
    assert "holds no MRPT landmark log" in failure(tmp_path, "mrpt-landmarks")
    assert "holds no Victoria Park log" in failure(tmp_path, "victoria-park")
    put(tmp_path, POINTS, "observations.csv")
    put(tmp_path, TREES, "trees.csv")
    assert "observation-csv and victoria-park" in failure(tmp_path)
    assert len(open_log(tmp_path, "victoria-park").rows) == 3


@pytest.mark.parametrize("content", ["hello world\n", "0,1.0,2.0\n", "ply\nformat ascii 1.0\n"])
def test_unknown_text(tmp_path: Path, content: str) -> None:
    message = failure(put(tmp_path, content, "log.csv"))
    assert (
        f"log.csv: line 1: {content.split(chr(10))[0]!r} does not start a landmark log" in message
    )
    assert "iteration,x,y[,z][,id]" in message


def test_non_files_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "is a device or pipe" in failure(tmp_path / "pipe")
    assert re.search("cannot be read: .*embedded null (byte|character)", failure("a\0b"))
    assert "cannot be read" in failure("a" * 300)
    assert "is empty" in failure(put(tmp_path, "", "empty"))


def test_unreadable_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", refuse)
    assert "cannot be read: Permission denied" in failure(tmp_path)


def test_mrpt_points_stand_in_the_robot_frame(tmp_path: Path) -> None:
    sensor = "# sensor on robot: t = 1 2 3 ; R (row major) = 0 -1 0 1 0 0 0 0 1\n"
    rows = "4,7,2,0,0\n4,-9,2,1.5707963267948966,0\n6,8,2,0,1.5707963267948966\n"
    log = open_log(put(tmp_path, sensor + SIGMA.format(0.1) + HEADER + rows, "log"))
    assert np.allclose(log.points_robot, [[1, 4, 3], [-1, 2, 3], [1, 2, 1]])
    assert log.ids.tolist() == [7, -9, 8]
    assert (log.first_iteration, log.end_iteration) == (4, 7)


@pytest.mark.parametrize(
    ("comments", "pitch", "columns"),
    [
        (SENSOR + SIGMA.format(0), "-0", 2),
        (SENSOR + SIGMA.format(0), "0.1", 3),
        (SENSOR + SIGMA.format(0.01), "0", 3),
        (SENSOR + SIGMA.format("x"), "0", 3),
        (SENSOR, "0", 3),
        (SENSOR.replace("1 0 0 0 1 0 0 0 1", "0 0 1 0 1 0 -1 0 0") + SIGMA.format(0), "0", 3),
    ],
)
def test_mrpt_planar(tmp_path: Path, comments: str, pitch: str, columns: int) -> None:
    log = open_log(put(tmp_path, f"{comments}{HEADER}0,1,2,0.3,{pitch}\n", "log"))
    assert log.points_robot.shape == (1, columns)


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (
            MRPT.replace("2,3,1,0,0", "2,3,-1,0,0"),
            ["line 6, field range_m", "'-1' is out of range"],
        ),
        (MRPT.replace("2,3,1,0,0", "2,3,1,45,0"), ["line 6, field yaw_rad", "radians"]),
        (MRPT.replace("0,-1,", "0,3,"), ["line 5, field id", "3 occurs twice in iteration 0"]),
        (MRPT.replace(",pitch_rad", ""), ["line 3", "missing column pitch_rad"]),
        (MRPT.replace(SENSOR, ""), ["no usable sensor pose", "# sensor on robot: t ="]),
        (MRPT.replace("t = 0 0 0", "t = 0 0"), ["no usable sensor pose"]),
        (MRPT.replace("t = 0 0 0", "t = 0 0 nan"), ["no usable sensor pose"]),
        (MRPT.replace("= 1 0 0", "= 2 0 0"), ["no usable sensor pose"]),
        (MRPT.replace("= 1 0 0", "= -1 0 0"), ["no usable sensor pose"]),
        (MRPT.replace("= 1 0 0", "= a 0 0"), ["no usable sensor pose"]),
        (MRPT.replace("= 1 0 0", "= 1 0"), ["no usable sensor pose"]),
    ],
)
def test_mrpt_bad_content(tmp_path: Path, content: str, parts: list[str]) -> None:
    message = failure(put(tmp_path, content, "log.csv"))
    for part in ["log.csv", *parts]:
        assert part in message


TRUTH = "1 2 3 5 0 0.0 7\n -1 0 .5 5 0 0.0 4 \n"
PATH_TRUTH = "% x y z yaw pitch roll\n\n1 2 3 1.5707963267948966 0 0\n0 0 0 0 0 1e-3\n"


def test_mrpt_truth(tmp_path: Path) -> None:
    landmarks = put(tmp_path, TRUTH, "a_ground_truth.txt")
    path = put(tmp_path, PATH_TRUTH, "a_ground_truth_robot_path.txt")
    for place in (landmarks, path, tmp_path / "a.observations.csv.gz", tmp_path, str(path)):
        ids, positions, poses = read_ground_truth(place)
        assert ids.tolist() == [7, 4]
        assert positions.tolist() == [[1, 2, 3], [-1, 0, 0.5]]
        assert poses.shape == (2, 4, 4)
        assert np.allclose(poses[0] @ [1, 0, 0, 1], [1, 3, 3, 1])
    assert is_ground_truth(landmarks)
    assert is_ground_truth(path)
    assert is_ground_truth(tmp_path)
    assert not is_ground_truth(tmp_path / "landmarks.csv")
    put(tmp_path, TRUTH, "b_ground_truth.txt")
    with pytest.raises(RelmapError, match=r"a_ground_truth.txt, b_ground_truth.txt$"):
        read_ground_truth(tmp_path)


@pytest.mark.parametrize(
    ("landmarks", "path", "problem"),
    [
        (TRUTH, None, "robot_path.txt: does not exist"),
        (None, PATH_TRUTH, "a_ground_truth.txt: does not exist"),
        ("", PATH_TRUTH, "a_ground_truth.txt: holds no row"),
        (
            TRUTH + "1 2 3 5 0 0.0 7\n",
            PATH_TRUTH,
            "line 1, field id: 7 is not an integer or occurs",
        ),
        (TRUTH + "1 2 3 5 0 0.0 1.5\n", PATH_TRUTH, "line 3, field id: 1.5 is not an integer"),
        (TRUTH + "1 2 x 5 0 0.0 9\n", PATH_TRUTH, "line 3: '1 2 x 5 0 0.0 9', expected 7 finite"),
        (TRUTH, PATH_TRUTH + "1 2 3 4 5\n", "line 5: '1 2 3 4 5', expected 6 finite numbers"),
        (TRUTH, PATH_TRUTH + "1 2 3 4 nan 6\n", "line 5: .* expected 6 finite numbers"),
    ],
)
def test_mrpt_bad_truth(
    tmp_path: Path, landmarks: str | None, path: str | None, problem: str
) -> None:
    if landmarks is not None:
        put(tmp_path, landmarks, "a_ground_truth.txt")
    if path is not None:
        put(tmp_path, path, "a_ground_truth_robot_path.txt")
    with pytest.raises(RelmapError, match=problem) as caught:
        read_ground_truth(tmp_path / "a_ground_truth.txt")
    assert str(caught.value).isprintable()
