"""Evaluating a damaged result, or against an invalid truth: one line of error."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from tests.commands import GOOD, Check, shown
from tests.hostile import WALLS

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("summary.json", b"", "not JSON"),
        ("summary.json", b"[]", "not a JSON object"),
        ("summary.json", b"{}", "scans"),
        ("landmarks.csv", b"", "is empty"),
        ("landmarks.csv", b"landmark,x\n", "no column y"),
        (
            "tracks.csv.gz",
            gzip.compress(b"iteration,row,landmark\n0,0,x\n", mtime=0),
            "line 2, field landmark",
        ),
        (
            "tracks.csv.gz",
            gzip.compress(b"iteration,row,landmark\n0,9999,1\n", mtime=0),
            "not the one",
        ),
        ("tracks.csv.gz", gzip.compress(b"iteration,row,landmark\n", mtime=0)[:-6], "gzip"),
        ("trajectory.tum", b"1 2 3\n", "expected 8 numbers"),
        ("trajectory.tum", b"\x00\x01", "NUL"),
        ("landmarks.csv", None, "does not exist"),
        ("tracks.csv.gz", None, "does not exist"),
        ("trajectory.tum", None, "does not exist"),
    ],
    ids=shown,
)
def test_damaged_result(
    place: Path, refused: Check, name: str, content: bytes | None, message: str
) -> None:
    if content is None:
        (place / "out" / name).unlink()
    else:
        (place / "out" / name).write_bytes(content)
    assert message in refused("evaluate", "out", "--truth", "truth", "--log", "log.csv")


@pytest.mark.parametrize("name", ["x1", "ny"])
def test_static_wall_without_an_end_or_a_normal(place: Path, refused: Check, name: str) -> None:
    header, first, last = (line.split(",") for line in WALLS.splitlines())
    last[header.index(name)] = ""
    rows = "\n".join(",".join(cells) for cells in (header, first, last))
    (place / "out" / "planes.csv").write_text(rows)
    message = f"wall 1 is static, but its field {name} is empty"
    assert message in refused("evaluate", "out", "--truth", "truth")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("landmark,x,y,z\n0,1,0,0\n", "no column status"),
        ("landmark,x,y,z,status\n0,1,0,,static\n", "line 2, field z"),
        ("landmark,x,y,z,status\n0,1,0,0,lost\n", "landmark 0 is 'lost'"),
        ("landmark,x,y,z,status\n0,1,0,0,static\n0,1,0,0,static\n", "occurs twice"),
    ],
)
def test_bad_truth(place: Path, refused: Check, text: str, message: str) -> None:
    (place / "truth" / "landmarks.csv").write_text(text)
    assert message in refused("evaluate", "out", "--truth", "truth")


def test_no_truth(place: Path, refused: Check) -> None:
    (place / "empty").mkdir()
    (place / "bad_ground_truth.txt").write_text("1 2 3\n")
    (place / "truth" / "trajectory.tum").write_text("1 2 3\n")
    assert "does not exist" in refused("evaluate", "out", "--truth", "none")
    assert "holds no truth" in refused("evaluate", "out", "--truth", "empty")
    assert "is not a truth" in refused("evaluate", "out", "--truth", "log.csv")
    assert "result folder" in refused("evaluate", "out", "--truth", "out")
    assert "result folder" in refused("evaluate", "out", "--truth", "out/landmarks.csv")
    assert "bad_ground_truth" in refused("evaluate", "out", "--truth", "bad_ground_truth.txt")
    assert "trajectory.tum: line 1" in refused("evaluate", "out", "--truth", "truth")


def test_another_log_is_refused(place: Path, refused: Check) -> None:
    (place / "short.csv").write_text("".join(GOOD.splitlines(keepends=True)[:20]))
    line = refused("evaluate", "out", "--truth", "truth", "--log", "short.csv")
    assert "not the one that was mapped" in line
