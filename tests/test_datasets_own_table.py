"""Arbitrary tables: names of columns, times, texts for ids, separators, frames, Parquet."""

from __future__ import annotations

import gzip
import math
import sys
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap.core.errors import RelmapError
from relmap.datasets import ObservationLog, log_of_frame, open_log
from tests.logs import failure, put

OWN = (
    "frame,t,px,py,colour,name\n3,0.5,1.5,-2,red,cone\n3,0.5,2,1,blue,post\n"
    "5,0.9,1,-2,red,cone\n6,1.0,7,7,,\n"
)
NAMES = {"x": "px", "y": "py", "iteration": "frame", "stamp": "t", "id": "name"}
CELLS: dict[str, list[Any]] = {
    "frame": [3, 3, 5, 6],
    "t": [0.5, 0.5, 0.9, 1.0],
    "px": [1.5, 2, 1, 7],
    "py": [-2, 1, -2, 7],
    "colour": ["red", "blue", "red", None],
    "name": ["cone", "post", "cone", None],
}


def check(log: ObservationLog) -> None:
    """Check that a log holds what `OWN` says."""
    assert log.points_robot.tolist() == [[1.5, -2], [2, 1], [1, -2], [7, 7]]
    assert log.iteration.tolist() == [3, 3, 5, 6]
    assert log.names == ("cone", "post")
    assert log.ids.tolist() == [0, 1, 0, -1]
    assert log.stamps_s.tolist() == [0.5, 0.7, 0.9, 1.0]
    assert log.rows.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    "content",
    [
        OWN,
        OWN.replace(",", ";"),
        OWN.replace(",", ";").replace("0.5", "0,5"),
        OWN.replace(",", "\t"),
        OWN.replace("red", '"light, red"').replace("cone", '"cone"'),
        OWN.replace("red", '"light, red"').replace("cone", '"cone"').replace(",", ", "),
        "# a comment\n\n" + OWN.replace("\n", "\r\n") + "\n\n",
    ],
)
def test_columns_are_given_by_name(
    tmp_path: Path, content: str, caplog: pytest.LogCaptureFixture
) -> None:
    for path in (put(tmp_path, content, "a.csv"), put(tmp_path, gzip.compress(content.encode()))):
        check(open_log(path, columns=NAMES))
        assert caplog.messages == [f"{path}: other columns are ignored: 'colour'"]
        caplog.clear()


@pytest.fixture(params=["pandas", "polars"])
def frames(request: pytest.FixtureRequest) -> Any:
    """A library of data frames."""
    return pytest.importorskip(request.param)


def test_frames_are_logs(frames: Any) -> None:
    check(log_of_frame(frames.DataFrame(CELLS), NAMES))


def test_ids_of_several_lines_are_the_same_in_a_frame_and_a_text(
    tmp_path: Path, frames: Any
) -> None:
    names = ["a\nb", "a\r\nb", "a\rb", "c"]
    table = {"iteration": [0, 1, 2, 2], "x": [1.0] * 4, "y": [2.0] * 4, "id": names}
    rows = [",".join(map(repr, row)).replace("'", '"') for row in zip(*table.values(), strict=True)]
    content = "\n".join(["iteration,x,y,id", *rows]).replace("\\r", "\r").replace("\\n", "\n")
    path = tmp_path / "a.csv"
    path.write_bytes(content.encode())
    for log in (log_of_frame(frames.DataFrame(table)), open_log(path, columns={"x": "x"})):
        assert (log.names, log.ids.tolist()) == (("a\nb", "c"), [0, 0, 0, 1])


def test_columns_of_pandas_may_be_numbered() -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(dict(enumerate(CELLS.values())))
    check(log_of_frame(frame, {name: str([*CELLS].index(own)) for name, own in NAMES.items()}))


@pytest.mark.parametrize("zone", [None, "UTC"])
def test_a_missing_time_is_named_by_its_row(zone: str | None) -> None:
    pandas = pytest.importorskip("pandas")
    times = pandas.to_datetime(["2020-01-01", None, "2020-01-03"]).tz_localize(zone)
    frame = pandas.DataFrame({"stamp": times, "x": [1.0, 2, 3], "y": [1.0, 2, 3]})
    with pytest.raises(RelmapError, match="row 1, field stamp: nan is not finite"):
        log_of_frame(frame)


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        ("iteration,range,bearing,elevation", {}),
        ("iteration,r,b,e", {"range": "r", "bearing": "b", "elevation": "e"}),
    ],
)
def test_ranges_and_bearings_are_read(
    tmp_path: Path, frames: Any, header: str, columns: dict[str, str]
) -> None:
    angle = math.radians(30)
    path = put(tmp_path, f"{header}\n0,2,{angle!r},0\n1,4,0,{-angle!r}\n", "a.csv")
    cells = dict(zip(header.split(","), ([0, 1], [2, 4], [angle, 0.0], [0.0, -angle]), strict=True))
    for log in (open_log(path, columns=columns), log_of_frame(frames.DataFrame(cells), columns)):
        expected = [[math.sqrt(3), 1, 0], [math.sqrt(12), 0, -2]]
        np.testing.assert_allclose(log.points_robot, expected, atol=1e-15)
    planar = put(tmp_path, "bearing,iteration,range,id\n3.5,7,2,1\n", "b.csv")
    expected = [[2 * math.cos(3.5), 2 * math.sin(3.5)]]
    np.testing.assert_allclose(open_log(planar).points_robot, expected)


@pytest.mark.parametrize("third", ["", ",elevation"])
def test_covariances_beside_ranges_and_bearings(tmp_path: Path, frames: Any, third: str) -> None:
    names = "cxx,cxy,cyy" + ",cxz,cyz,czz" * bool(third)
    values = [0.04, 0.01, 0.09, 0.0, 0.02, 0.16] if third else [0.04, 0.01, 0.09]
    header = f"iteration,range,bearing{third},{names}"
    row = [0, 2, 0.5, *([0.25] if third else []), *values]
    path = put(tmp_path, f"{header}\n{','.join(map(str, row))}\n")
    frame = frames.DataFrame(
        {name: [cell] for name, cell in zip(header.split(","), row, strict=True)}
    )
    expected = [[0.04, 0.01, 0.0], [0.01, 0.09, 0.02], [0.0, 0.02, 0.16]]
    d = 3 if third else 2
    for log in (open_log(path), open_log(path, columns={}), log_of_frame(frame)):
        assert log.covariances.tolist() == [[line[:d] for line in expected[:d]]]
    put(tmp_path, f"iteration,range,bearing{third},cxx\n{','.join(map(str, row[: d + 2]))}\n")
    assert f"covariances need the columns {names.replace(',', ', ')}" in failure(path)


def test_a_wrong_covariance_is_named_by_its_line(tmp_path: Path) -> None:
    path = put(tmp_path, "# c\niteration,x,y,cxx,cxy,cyy\n0,1,2,1,0,1\n\n1,1,2,1,3,1\n", "a.csv")
    assert "covariances line 5 is [[1.0, 3.0], [3.0, 1.0]]; it must be positive" in failure(path)


@pytest.mark.parametrize(
    ("header", "columns", "point", "ignored"),
    [
        ("iteration,x,y,range,bearing", {}, [1, 2], "'range', 'bearing'"),
        ("iteration,x,y,range,bearing", {"bearing": "bearing"}, [3, 0], "'x', 'y'"),
        ("iteration,px,py,range,bearing", {"x": "px", "y": "py"}, [1, 2], "'range', 'bearing'"),
        ("iteration,x,y,range,b", {"bearing": "b"}, [3, 0], "'x', 'y'"),
        ("iteration,x,a,range,bearing", {}, [3, 0], "'x', 'a'"),
    ],
)
def test_one_kind_of_coordinates_is_used(
    tmp_path: Path,
    frames: Any,
    caplog: pytest.LogCaptureFixture,
    header: str,
    columns: dict[str, str],
    point: list[float],
    ignored: str,
) -> None:
    path = put(tmp_path, f"{header}\n0,1,2,3,0\n", "a.csv")
    cells = dict(zip(header.split(","), ([0], [1], [2], [3], [0]), strict=True))
    for log in (open_log(path, columns=columns), log_of_frame(frames.DataFrame(cells), columns)):
        assert log.points_robot.tolist() == [point]
    warning = f"other columns are ignored: {ignored}"
    assert caplog.messages == [f"{path}: {warning}", f"data frame: {warning}"]


def test_parquet_is_read(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table(CELLS), tmp_path / "a")
    check(open_log(tmp_path / "a", columns=NAMES))
    renamed = pyarrow.table({"iteration": [1, 0], "x": [1, 2], "y": [3.5, 4]})
    pyarrow.parquet.write_table(renamed, tmp_path / "b.parquet")
    log = open_log(tmp_path / "b.parquet")
    assert log.points_robot.tolist() == [[2, 4], [1, 3.5]]
    assert log.rows.tolist() == [1, 0]


def test_ids_in_lists_are_refused(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    table = pyarrow.table({"iteration": [0, 1], "x": [1, 2], "y": [3, 4], "id": [[1, 2], [3]]})
    pytest.importorskip("pyarrow.parquet").write_table(table, tmp_path / "a.parquet")
    expected = "row 1, field id: a list, expected a name or number"
    assert failure(tmp_path / "a.parquet").endswith(expected)


def test_without_pyarrow_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = put(tmp_path, b"PAR1" + bytes(20) + b"PAR1", "a.parquet")
    assert failure(path).endswith("is a Parquet file: pip install 'relmap[parquet]' to read it")


def test_times_alone_number_the_iterations(frames: Any) -> None:
    stamps = [datetime(1970, 1, 1, 0, 0, 1, part) for part in (500_000, 250_000, 500_000)]
    log = log_of_frame(frames.DataFrame({"stamp": stamps, "x": [1, 2, 3], "y": [0.5] * 3}))
    assert log.iteration.tolist() == [0, 1, 1]
    assert log.points_robot[:, 0].tolist() == [2, 1, 3]
    assert log.stamps_s.tolist() == [1.25, 1.5]
    assert log.ids is None


def test_times_may_be_in_a_time_zone(frames: Any) -> None:
    east = timezone(timedelta(hours=1))
    stamps = [datetime(1970, 1, 1, 1, 0, k, tzinfo=east) for k in range(3)]
    log = log_of_frame(frames.DataFrame({"stamp": stamps, "x": [1, 2, 3], "y": [0.5] * 3}))
    assert log.stamps_s.tolist() == [0, 1, 2]


def test_other_objects_than_frames_are_refused() -> None:
    with pytest.raises(RelmapError, match="expected a DataFrame of pandas or polars, got a dict"):
        log_of_frame({"x": [1.0], "y": [2.0]})


@pytest.mark.parametrize(
    ("cells", "ids", "names"),
    [
        ([3, 4, 3], [3, 4, 3], None),
        ([3.0, float("nan"), 4.0], [3, -1, 4], None),
        (["3", "", "-7"], [3, -1, -7], None),
        (["b", "a", "7"], [2, 1, 0], ("7", "a", "b")),
        (["a", None, "a"], [0, -1, 0], ("a",)),
        ([True, False, True], [1, 0, 1], ("False", "True")),
    ],
)
def test_ids_are_numbers_or_texts(
    frames: Any, cells: list[Any], ids: list[int], names: tuple[str, ...] | None
) -> None:
    frame = frames.DataFrame({"iteration": [0, 1, 2], "x": [1.0] * 3, "y": [2] * 3, "id": cells})
    log = log_of_frame(frame)
    assert log.ids.tolist() == ids
    assert log.names == names


def test_times_of_an_observation_log(tmp_path: Path) -> None:
    log = open_log(put(tmp_path, "iteration,x,y,stamp\n1,1,1,10\n3,2,2,11\n"))
    assert log.stamps_s.tolist() == [10, 10.5, 11]
    semicolons = put(tmp_path, "x;y;iteration\n1,5;2;0\n.5;1e0;1\n", "b.csv")
    assert open_log(semicolons).points_robot.tolist() == [[1.5, 2], [0.5, 1]]
    assert "line 2, field x: '1,5' is not a number" in failure(
        put(tmp_path, "x\ty\titeration\n1,5\t2\t0\n", "c.csv")
    )


@pytest.mark.parametrize(
    ("content", "columns", "problem"),
    [
        (OWN, NAMES | {"x": "left"}, "no column 'left', expected one; there are 'frame', 't'"),
        (OWN, {"x": "px", "y": "py"}, "no column 'iteration', expected one"),
        (OWN.replace("colour", "px"), NAMES, "two columns 'px', expected one"),
        (OWN, NAMES | {"w": "t"}, "columns: 'w', expected some of iteration, x, y, z, id, stamp"),
        (OWN.replace("1.5", "far"), NAMES, "line 2, field px: 'far', expected a number of metres"),
        (OWN.replace("1.5", "inf"), NAMES, "line 2, field x: inf is not finite"),
        (OWN.replace("5,0.9", "5.5,0.9"), NAMES, "line 4, field iteration: 5.5 is not an integer"),
        (OWN.replace(",red", ""), NAMES, "line 2: 5 fields, expected 6 as in the header"),
        (OWN.replace("post", "cone"), NAMES, "line 3, field id: 0 occurs twice in iteration 3"),
        (OWN.replace("post", "p" * 300), NAMES, "expected at most 200 characters"),
        (OWN.partition("\n")[0], NAMES, "holds no row"),
        ("iteration,range,bearing\n0,2,30\n", {}, "line 2, field bearing: 30 is out of range"),
        ("i,r,b\n0,2,1\n", {"range": "r", "iteration": "i"}, "no column 'bearing'"),
        (
            "iteration,px,py,r,bearing\n0,1,2,3,0\n",
            {"x": "px", "y": "py", "range": "r"},
            "columns: x and range, expected either x, y or range, bearing",
        ),
        (
            "iteration,bearing\n0,1\n",
            {"range": "bearing"},
            "'bearing' would be two coordinates, expected another name for each of range, bearing",
        ),
        ("iteration,y\n0,1\n", {"x": "y"}, "expected another name for each of x, y and z"),
        ("iteration,bearing\n0,1\n", {}, "no column 'range'"),
        (OWN.replace("red", '"red', 1), NAMES, "line 5: unexpected end of data"),
    ],
)
def test_wrong_tables(tmp_path: Path, content: str, columns: dict[str, str], problem: str) -> None:
    path = put(tmp_path, content)
    with pytest.raises(RelmapError) as caught:
        open_log(path, columns=columns)
    assert problem in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("cells", "problem"),
    [
        ({"x": [1.0, "far"]}, "data frame: row 1, field x: 'far', expected a number of metres"),
        ({"x": [1.0, np.nan]}, "data frame: row 1, field x: nan is not finite"),
        ({"iteration": [0, 0.5]}, "data frame: row 1, field iteration: 0.5 is not an integer"),
        ({"id": ["a", "b" * 300]}, "data frame: row 1, field id: 'bbb"),
        ({"y": [[1], [2]]}, "data frame: row 0, field y: '[1]', expected a number"),
    ],
)
def test_wrong_frames(frames: Any, cells: dict[str, list[Any]], problem: str) -> None:
    try:
        frame = frames.DataFrame({"iteration": [0, 1], "x": [1.0, 2], "y": [0.0, 1]} | cells)
    except TypeError:
        pytest.skip("polars makes no column of several types")
    with pytest.raises(RelmapError) as caught:
        log_of_frame(frame)
    assert problem in str(caught.value)


def test_a_damaged_parquet_file_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    message = failure(put(tmp_path, b"PAR1" + bytes(200) + b"PAR1", "a.parquet"))
    assert "a.parquet: cannot be read as a Parquet file: " in message
