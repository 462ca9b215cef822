"""The page of a run: complete, self-contained, escaped."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap.cli import main
from relmap.cli.job import Job
from tests.commands import load, table
from tests.everyformat import NASTY, Mapped
from tests.logs import first_scans

pytestmark = pytest.mark.usefixtures("unrendered")

MOST_BYTES = 1_000_000


class Parsed(HTMLParser):
    """The words of a page, the attributes of its tags, and its scripts."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words, self.attributes = "", list[tuple[str, str | None]]()
        self.scripts, self._tags = list[str](), list[str]()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += attrs
        self._tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self._tags and self._tags.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if "script" in self._tags:
            self.scripts.append(data)
        elif "style" not in self._tags:
            self.words += data


def views(page: str) -> list[dict[str, Any]]:
    content = json.loads(Parsed(page).scripts[0])
    assert isinstance(content, list)
    return content


def numbers(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(b64decode(text), kind)


@pytest.mark.parametrize("source", ["npz", "clouds", "csv/observations.csv", "flat"])
def test_a_page_makes_no_requests(mapped: Mapped, source: str) -> None:
    page = (mapped(source) / "report.html").read_text()
    parsed = Parsed(page)
    assert not {name for name, _ in parsed.attributes} & {"src", "href", "srcset", "action"}
    assert "default-src 'none'" in page
    assert not re.search(r"https?://|url\(|@import|fetch\(|XMLHttpRequest|import\(", page)
    assert len(page) < MOST_BYTES


def test_a_page_holds_the_map_and_how_it_was_made(mapped: Mapped) -> None:
    folder = mapped("npz")
    page = (folder / "report.html").read_text()
    (view,) = views(page)
    rows = [row for row in table(folder / "planes.csv") if row["x0"]]
    ends = [[float(row[name]) for name in ("x0", "y0", "x1", "y1")] for row in rows]
    np.testing.assert_allclose(numbers(view["lines"], "<f4").reshape(-1, 4), ends, rtol=1e-6)
    assert numbers(view["lineNames"], "<i4").tolist() == [int(row["plane"]) for row in rows]
    assert len(numbers(view["path"], "<f4")) == 2 * 16
    points = numbers(view["points"], "<u2").reshape(-1, 2) * view["pointStep"] + view["pointLow"]
    scan = numbers(view["pointFrom"], "<i4")
    assert (scan[0], scan[-1], len(scan)) == (0, len(points), 17)
    assert np.ptp(points, axis=0).min() > 1.0
    words, summary = Parsed(page).words, load(folder / "summary.json")
    assert "relmap map npz -o RESULT --variant planes" in words
    for key, value in summary["versions"].items():
        assert f"{key}{value}" in words.replace("\n", "")
    assert f"planes static{summary['counts']['planes_static']}" in words
    assert "group after10" in words


def test_the_command_maps_the_same_again(logs: Path, tmp_path: Path) -> None:
    more = ["--association", "known", "--no-refine", "--scans", "2:25"]
    more += ["--range-sigma", "0.05", "--bearing-sigma", "0.01"]
    assert main(["map", str(logs / "flat"), "-o", str(tmp_path / "a"), *more]) == 0
    page = (tmp_path / "a" / "report.html").read_text()
    assert "<td>scans</td><td>2:25</td>" in page
    (command,) = re.findall("<code>relmap (.*)</code>", page)
    words = command.replace("RESULT", str(tmp_path / "b")).replace("flat", str(logs / "flat"))
    assert main(words.split()) == 0
    assert (tmp_path / "b" / "report.html").read_text() == page
    assert (tmp_path / "b" / "landmarks.csv").read_bytes() == (
        tmp_path / "a" / "landmarks.csv"
    ).read_bytes()


def test_the_command_has_what_the_log_needs() -> None:
    given: dict[str, Any] = {"columns": {"x": "px", "id": "my name"}, "topics": ("/a", "/b")}
    job = Job(source=Path("seen.csv"), out=Path("out"), odometry="none", **given)
    assert job.command == (
        "relmap map seen.csv -o RESULT --columns 'x=px,id=my name' --odometry none "
        "--topic /a --topic /b"
    )
    for level, more in (("none", " --level none"), ("auto", "")):
        given = {"variant": "planes", "odometry": "auto", "level": level}
        job = Job(source=Path("hall"), out=Path("out"), **given)
        assert job.command == f"relmap map hall -o RESULT --variant planes{more}"


def test_names_are_text(nasty: Path) -> None:
    parsed = Parsed(nasty.read_text())
    assert len(parsed.scripts) == 2
    assert NASTY in parsed.words


def test_every_run_has_a_page(tmp_path: Path) -> None:
    """Without mapped landmarks, and with separate submaps."""
    (tmp_path / "one.csv").write_text("iteration,x,y\n0,1,2\n")
    assert main(["map", str(tmp_path / "one.csv"), "-o", str(tmp_path / "one")]) == 0
    (view,) = views((tmp_path / "one" / "report.html").read_text())
    assert view["caption"] == "0 poses, 0 landmarks"
    world = ["--world", "bare-corridor", "--sampling", "laser", "--points", "181"]
    run = ["simulate", "building", "-o", str(tmp_path / "world"), *world, "--iterations", "60"]
    assert main(run) == 0
    run = ["map", str(tmp_path / "world"), "-o", str(tmp_path / "out"), "--variant", "planes"]
    assert main(run) == 0
    page = (tmp_path / "out" / "report.html").read_text()
    submaps = load(tmp_path / "out" / "summary.json")["submaps"]
    assert len(submaps) > 1
    assert f"the run broke into {len(submaps)} submaps" in page
    assert len(views(page)) == 1 + sum(submap["scans"] >= 10 for submap in submaps[1:])


def test_freiburg_079_is_at_most_a_megabyte(shared_data: Path, tmp_path: Path) -> None:
    packed = shared_data / "carmen-laser2d" / "freiburg-079-corrected.log.gz"
    log = str(first_scans(packed, 400, tmp_path))
    run = ["map", log, "-o", str(tmp_path / "out"), "--variant", "planes"]
    assert main(run) == 0
    page = (tmp_path / "out" / "report.html").read_text()
    (view, *_) = views(page)
    # Of the whole log there are as many points, and twelve times as many poses and walls.
    points = sum(len(view[name]) for name in ("points", "pointFrom"))
    assert points + 12 * (len(page) - points) < MOST_BYTES
