"""The observation log as CSV: what is read, what is written, and every kind of bad input."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relmap.datasets import open_log, table, textfile
from relmap.datasets.number_rows import parse_number
from tests.logs import PLAIN, failure, put


def test_reads_points_ids_and_empty_iterations(tmp_path: Path) -> None:
    log = open_log(put(tmp_path, PLAIN))
    assert log.points_robot.tolist() == [[1.5, -2, 0.25], [3, 4, 5], [1, 2, 3]]
    assert log.points_robot.dtype == np.float64
    assert log.iteration.tolist() == [0, 0, 2]
    assert log.ids.tolist() == [7, 8, 7]
    assert log.ids.dtype == log.rows.dtype == log.iteration.dtype == np.int64
    assert (log.first_iteration, log.end_iteration, log.stamps_s) == (0, 3, None)
    assert [len(scan.points_robot) for scan in log.scans()] == [2, 0, 1]


def test_without_z_and_id_the_world_is_planar_and_association_unknown(tmp_path: Path) -> None:
    log = open_log(put(tmp_path, "iteration,x,y\n5,1,2\n"))
    assert log.points_robot.tolist() == [[1, 2]]
    assert log.ids is None
    assert (log.first_iteration, log.end_iteration) == (5, 6)


@pytest.mark.parametrize(
    "content",
    [
        PLAIN.rstrip("\n"),
        PLAIN + "\n  \n\n",
        PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("\n", "\r"),
        "\ufeff" + PLAIN,
        "# from a robot\n\n#\n" + PLAIN,
        PLAIN.replace(",", " , "),
        re.sub(r"[^,\n]+", r'"\g<0>"', PLAIN),
        re.sub(r"[a-z]+", r'"\g<0>"', PLAIN),
        "id,z,x,iteration,y\n7,.25,1.5,0,-2\n8,5e0,+3,0.0,4\n7,3,1,2,2\n",
    ],
)
def test_harmless_variations_change_nothing(tmp_path: Path, content: str) -> None:
    expected = open_log(put(tmp_path, PLAIN, "plain.csv"))
    for path in (put(tmp_path, content), put(tmp_path, gzip.compress(content.encode()), "odd")):
        log = open_log(path)
        assert np.array_equal(log.points_robot, expected.points_robot)
        assert np.array_equal(log.iteration, expected.iteration)
        assert log.ids.tolist() == [7, 8, 7]


def test_empty_and_negative_ids_are_not_identified(tmp_path: Path) -> None:
    log = open_log(put(tmp_path, "iteration,x,y,id\n0,1,2,\n0,1,2,-1\n0,1,2,-1\n0,3,4, \n0,3,4,9"))
    assert log.ids.tolist() == [-1, -1, -1, -1, 9]


@pytest.mark.parametrize("name", ["observations.csv", "observations.csv.gz"])
def test_folder(tmp_path: Path, name: str) -> None:
    content = gzip.compress(PLAIN.encode()) if name.endswith("gz") else PLAIN
    put(tmp_path, content, name)
    assert len(open_log(tmp_path).rows) == len(open_log(tmp_path, "observation-csv").rows) == 3


def test_folder_with_both_files_is_ambiguous(tmp_path: Path) -> None:
    put(tmp_path, PLAIN)
    put(tmp_path, PLAIN, "observations.csv.gz")
    assert "expected one of observations.csv, observations.csv.gz" in failure(tmp_path)


@pytest.mark.parametrize("seed", range(5))
def test_order_of_rows_does_not_matter(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = [f"{k // 3},{k},{-k},{k % 3}" for k in range(60)]
    order = rng.permutation(len(rows))
    shuffled = "\n".join(["iteration,x,y,id", *(rows[k] for k in order)])
    log = open_log(put(tmp_path, shuffled))
    assert np.array_equal(log.iteration, np.repeat(np.arange(20), 3))
    assert np.array_equal(order[log.rows], log.points_robot[:, 0])
    for scan in log.scans():
        assert (np.diff(scan.rows) > 0).all()


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        ("", ["is empty"]),
        ("\n\n", ["holds no header"]),
        ("# only a comment\n", ["holds no header"]),
        ("iteration,x,y\n", ["header but no row"]),
        ("iteration,x,y\n\n\n", ["header but no row"]),
        ("iteration,x\n0,1\n", ["line 1", "missing column y", "iteration,x,y[,z][,id]"]),
        ("iteration\n0\n", ["missing columns x, y"]),
        ("# c\nframe,x,y\n0,1,2\n", ["line 2", "missing column iteration", "'frame'"]),
        ("iteration|x|y\n0|1|2\n", ["line 1", "columns iteration, x, y", "'iteration|x|y'"]),
        ("x,y,stamp\n1,2,3\n", ["line 1", "missing column iteration"]),
        ("range,bearing,stamp\n1,2,3\n", ["line 1", "missing column iteration", "range,bearing["]),
        ("iteration,bearing\n0,1\n", ["line 1", "missing column range"]),
        (
            "iteration,x,y,range,bearing\n0,1,2,3,0\n",
            ["columns x, y and also range, bearing, expected either", "--columns x=x,y=y ignores"],
        ),
        ("iteration,x,y,x\n0,1,2,3\n", ["line 1", "duplicate column x"]),
        ("iteration,x,y,w,v\n0,1,2,3,4\n", ["unknown columns 'w', 'v'", "x, y, z, id"]),
        ("iteration,x,y,w\n0,1,2,3\n", ["unknown column 'w'", "--columns x=x ignores the others"]),
        ("iteration,range,bearing,w\n0,1,2,3\n", ["--columns range=range ignores the others"]),
        ("iteration,x,y,\n0,1,2,\n", ["unknown column ''"]),
        ("iteration,x,y\n0,1,2\n0,nan,2\n", ["line 3, field x", "'nan' is not finite"]),
        ("iteration,x,y\n0,1,-inf\n", ["line 2, field y", "'-inf' is not finite"]),
        ("iteration,x,y\n0,1,1e999\n", ["line 2, field y", "'1e999' is not finite"]),
        ("iteration,x,y\n0,1,two\n", ["line 2, field y", "'two' is not a number", "metres"]),
        ("iteration,x,y\n\n0,1,\n", ["line 3, field y", "is empty"]),
        ("iteration,x,y\n0,1_0,2\n", ["line 2, field x", "'1_0' is not a number"]),
        ("iteration,x,y\n0,\u0661,2\n", ["line 2, field x", "is not a number"]),
        ("iteration,x,y\n0,0x10,2\n", ["line 2, field x", "'0x10' is not a number"]),
        ('iteration,x,y\n0,"1,2\n', ["line 2, field x", "'\"1' is not a number"]),
        ('iteration,x,y\n0,"1"",2\n', ["line 2, field x", "is not a number"]),
        ("Iteration,X,Y\n0,1,2\n", ["missing columns iteration, x, y", "--columns iteration=..."]),
        ("iteration,x,y\n0,1,2\n0,1\n0,1,2\n", ["line 3", "2 fields in '0,1'", "expected 3"]),
        ("iteration,x,y\n0,1,2\n# note\n", ["line 3", "1 fields in '# note'", "expected 3"]),
        ("iteration,x,y\n0,1,2,3\n", ["line 2", "4 fields", "expected 3: iteration,x,y"]),
        ("iteration,x,y\n-1,1,2\n", ["line 2, field iteration", "'-1' is out of range"]),
        ("iteration,x,y\n0.5,1,2\n", ["line 2, field iteration", "'0.5' is not an integer"]),
        ("iteration,x,y\n100000001,1,2\n", ["line 2, field iteration", "to 100000000"]),
        ("iteration,x,y\n1e300,1,2\n", ["line 2, field iteration", "out of range"]),
        ("iteration,x,y\n9000000,1,2\n5,1,2\n", ["line 2, field iteration", "comes after 5"]),
        ("iteration,x,y\n0,2e9,2\n", ["line 2, field x", "'2e9' is out of range", "metres"]),
        ("iteration,x,y,id\n0,1,2,1.5\n", ["line 2, field id", "'1.5' is not an integer"]),
        ("iteration,x,y,id\n0,1,2,post\n", ["to 9007199254740991 (texts: --columns id=id)"]),
        ("iteration,x,y,id\n0,1,2,9007199254740993\n", ["line 2, field id", "out of range"]),
        (
            "iteration,x,y,id\n1,0,0,5\n0,1,2,5\n\n0,1,2,6\n0,3,4,5\n1,0,0,5\n",
            ["line 6, field id", "5 occurs twice in iteration 0", "line 3"],
        ),
        (PLAIN.encode("utf-16"), ["line 1", "NUL byte", "UTF-8"]),
        (b"iteration,x,y\n0,1,2\n0,1,\x00\n", ["line 3", "NUL byte"]),
        (b"\x7fELF\x02\x01\x01\x00\x00rubbish", ["line 1", "NUL byte"]),
        (b"iteration,x,\xff\n0,1,2\n", ["line 1", "byte 0xff is not UTF-8"]),
        (b"iteration,x,y\n0,1,2\n0,\xe9,2\n", ["line 3", "byte 0xe9 is not UTF-8"]),
        (b"# Universit\xe9\niteration,x,y\n0,1,2\n", ["line 1", "byte 0xe9 is not UTF-8"]),
        (b"iteration,x,y\n0,1,2\n" + b"1" * 200_000, ["line 3", "a line of more than"]),
    ],
)
def test_bad_content_is_reported_with_its_location(
    tmp_path: Path, content: str | bytes, parts: list[str]
) -> None:
    data = content.encode() if isinstance(content, str) else content
    put(tmp_path, data)
    put(tmp_path, gzip.compress(data), "log.gz")
    for path in (tmp_path / "observations.csv", tmp_path / "log.gz"):
        for message in (failure(path), failure(path, "observation-csv")):
            assert str(path) in message
            for part in parts:
                assert part in message
    (tmp_path / "log.gz").unlink()
    assert failure(tmp_path) == failure(tmp_path / "observations.csv")


def test_damaged_gzip(tmp_path: Path) -> None:
    rows = "".join(f"{k},{k / 7},{k / 3}\n" for k in range(5000))
    whole = gzip.compress(f"iteration,x,y\n{rows}".encode(), mtime=0)
    for size in (3, 12, 20, len(whole) // 2, len(whole) - 1):
        assert "damaged gzip" in failure(put(tmp_path, whole[:size]))
    for position in (len(whole) // 2, len(whole) - 6):
        damaged = bytearray(whole)
        damaged[position] ^= 0x55
        failure(put(tmp_path, bytes(damaged)))
    assert "damaged gzip" in failure(put(tmp_path, whole + b"rubbish"))


def test_gzip_bomb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put(tmp_path, gzip.compress(b"iteration,x,y\n" + b"0,1,2\n" * 1_000_000, 9))
    monkeypatch.setattr(textfile, "MAX_BYTES", 1_000_000)
    assert "more than 1000000 bytes of text" in failure(path)
    path = put(tmp_path, gzip.compress(b"iteration,x,y\n" + b"0" * 50_000_000, 9))
    assert "a line of more than" in failure(path)


def test_a_message_never_holds_a_line_break(tmp_path: Path) -> None:
    path = put(tmp_path, "iteration,x,y\n0,\x1b[31m\x0bfoo,2\n", "odd\nname \udcff.csv")
    message = failure(path)
    assert "odd\\nname" in message
    assert "\\x1b[31m" in message


def test_permission_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put(tmp_path, PLAIN)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    assert f"{path}: cannot be read: Permission denied" in failure(path, "observation-csv")
    assert "Permission denied" in failure(path)


# 1_0 and the like: Python reads them as numbers, numpy does not.
CELLS = st.one_of(
    st.text(st.sampled_from('0123456789+-._eE naif\t\u0661\xa0x#"'), max_size=6),
    st.floats().map(repr),
)


@given(rows=st.lists(st.lists(CELLS, min_size=1, max_size=3), min_size=1, max_size=4))
def test_both_ways_to_parse_agree(rows: list[list[str]]) -> None:
    batch = [",".join(row) + "\n" for row in rows]
    fast = table.parse_fast(batch, 2)
    try:
        exact = [[parse_number(cell.strip()) for cell in row.split(",")] for row in batch]
    except ValueError:
        assert fast is None
        return
    if any(len(row) != 2 for row in exact):
        assert fast is None
    elif fast is not None:
        assert np.array_equal(fast, exact, equal_nan=True)
    else:
        assert not batch[0].strip()
