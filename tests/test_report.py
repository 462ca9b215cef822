"""The page of a run: complete, self-contained, escaped; and in a browser, where there is one."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from relmap.cli import main
from relmap.cli.job import Job
from tests.browser import Page, browser, found
from tests.commands import load, table
from tests.everyformat import Mapped
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


NASTY = "a <script>alert(1)<script> & $x$ \"q\" 'p'.csv"


@pytest.fixture(scope="module")
def nasty(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a log with a name that is none of HTML."""
    folder = tmp_path_factory.mktemp("nasty")
    (folder / NASTY).write_bytes((logs / "flat/observations.csv").read_bytes())
    log = folder / NASTY
    assert main(["map", str(log), "-o", str(folder / "out")]) == 0
    return folder / "out" / "report.html"


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


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    chromium = found()
    if chromium is None:
        pytest.skip("no Chromium on the PATH: the page of a run is not looked at in a browser")
    with browser(chromium, tmp_path_factory.mktemp("browser")) as opened:
        yield opened


def shown(page: Page) -> str:
    """Return what is drawn, as a text."""
    return str(page.run("document.getElementById('map').toDataURL()"))


def slide(page: Page, to: int) -> None:
    at = "document.getElementById('time')"
    page.run(f"{at}.value = {to}; {at}.dispatchEvent(new Event('input'))")
    page.settle()


def middle(page: Page) -> tuple[float, float]:
    box = "document.getElementById('map').getBoundingClientRect()"
    x, y = page.run(f"(b => [b.x + b.width / 2, b.y + b.height / 2])({box})")
    return x, y


@pytest.mark.parametrize("source", ["npz", "csv/observations.csv", "beacons"])
@pytest.mark.parametrize("phone", [False, True])
def test_a_page_opens_without_requests_and_errors(
    mapped: Mapped, page: Page, source: str, phone: bool
) -> None:
    path = mapped(source) / "report.html"
    page.open(path, *((390, 844, True) if phone else ()))
    assert page.requested == [path.as_uri()]
    assert page.errors == []
    assert page.run("window.innerWidth") == (390 if phone else 1200)
    root = "document.documentElement"
    assert page.run(f"{root}.scrollWidth") == page.run(f"{root}.clientWidth")  # nothing sticks out
    assert "iteration" in page.text("now")
    wide = page.run("document.getElementById('map').clientWidth")
    assert (350 if phone else 1000) < wide < (390 if phone else 1200)


def test_the_drawing_agrees_with_the_map(mapped: Mapped, page: Page, tmp_path: Path) -> None:
    """Blue is where the walls are: in the picture, by its scale bar, as in the table."""
    page.open(mapped("npz") / "report.html")
    page.run("window.scrollTo(0, 0)")
    page.picture(tmp_path / "page.png")
    with Image.open(tmp_path / "page.png") as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    row, column = np.nonzero(
        (np.abs(pixels - [0x1F, 0x4E, 0x9E]).sum(axis=2) < 60) & (np.arange(900) < 700)[:, None]
    )
    metre = float(page.run("document.getElementById('scale').clientWidth")) / float(
        page.text("scale").removesuffix(" m")
    )
    rows = [row for row in table(mapped("npz") / "planes.csv") if row["x0"]]
    x = [float(row[name]) for row in rows for name in ("x0", "x1")]
    y = [float(row[name]) for row in rows for name in ("y0", "y1")]
    assert np.ptp(column) / metre == pytest.approx(np.ptp(x), rel=0.03)
    assert np.ptp(row) / metre == pytest.approx(np.ptp(y), rel=0.03)


def test_the_map_zooms_where_the_pointer_is_and_pans(mapped: Mapped, page: Page) -> None:
    page.open(mapped("npz") / "report.html")
    x, y = middle(page)
    x, y = x + 120, y - 40

    def under() -> list[float]:
        page.mouse("mouseMoved", x, y)
        page.settle()
        return [float(word) for word in re.findall(r"-?\d+\.\d+", page.text("under"))[:2]]

    before, whole = under(), shown(page)
    page.mouse("mouseWheel", x, y, deltaX=0, deltaY=-700)
    page.settle()
    assert shown(page) != whole
    np.testing.assert_allclose(under(), before, atol=0.011)
    page.mouse("mousePressed", x, y, button="left", buttons=1)
    page.mouse("mouseMoved", x + 60, y + 30, button="left", buttons=1)
    page.mouse("mouseReleased", x + 60, y + 30, button="left")
    page.settle()
    moved = under()
    assert moved[0] < before[0]
    assert moved[1] > before[1]
    page.click("#whole")
    assert shown(page) == whole
    for button in ("#in", "#out"):
        page.click(button)
    assert page.errors == []


def test_two_fingers_zoom(mapped: Mapped, page: Page) -> None:
    page.open(mapped("npz") / "report.html", 390, 844, True)
    x, y = middle(page)
    before = page.text("scale"), page.run("document.getElementById('scale').clientWidth")
    for k, kind in enumerate(["touchStart", *["touchMove"] * 4, "touchEnd"]):
        apart = 20 + 15 * k
        points = [{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}]
        touches = [] if kind == "touchEnd" else points
        page.ask("Input.dispatchTouchEvent", type=kind, touchPoints=touches)
    page.settle()
    after = page.text("scale"), page.run("document.getElementById('scale').clientWidth")
    before_m, after_m = (float(text.removesuffix(" m")) / px for text, px in (before, after))
    assert before_m / after_m == pytest.approx(80 / 20, rel=0.15)


def test_the_slider_replays_the_run(mapped: Mapped, page: Page) -> None:
    page.open(mapped("npz") / "report.html")
    end = shown(page)
    pictures = []
    for k in (0, 8, 15):
        slide(page, k)
        assert page.text("now").startswith(f"iteration {k}, ")
        pictures.append(shown(page))
    assert len(set(pictures)) == 3
    assert pictures[-1] == end
    slide(page, 3)
    page.click("#play")
    assert page.text("play") == "stop"
    page.click("#play")
    assert page.text("play") == "play"


def test_the_other_side_and_submaps(mapped: Mapped, page: Page) -> None:
    page.open(mapped("csv/observations.csv") / "report.html")
    above = shown(page)
    page.click("#side")
    assert shown(page) != above
    assert page.text("side") == "from above"
    page.click("#side")
    assert shown(page) == above
    page.open(mapped("npz") / "report.html")
    assert page.run("document.getElementById('side').hidden")
    assert page.run("document.getElementById('view').hidden")


def test_weak_links_lead_to_their_place(page: Page, tmp_path: Path) -> None:
    world = ["--world", "corridor", "--sampling", "laser", "--points", "181", "--sigma", "0.01"]
    assert main(["simulate", "building", "-o", str(tmp_path / "world"), *world]) == 0
    run = ["map", str(tmp_path / "world"), "-o", str(tmp_path / "out"), "--variant", "planes"]
    assert main(run) == 0
    page.open(tmp_path / "out" / "report.html")
    links = page.run("[...document.querySelectorAll('#links button')].map(b => b.textContent)")
    assert len(links) > 0
    assert {int(link) for link in links} <= set(
        load(tmp_path / "out" / "summary.json")["weak_links"]
    )
    page.click("#links button")
    assert page.text("now").startswith(f"iteration {links[0]}, ")


def test_a_browser_takes_nasty_names_for_text(nasty: Path, page: Page) -> None:
    page.open(nasty)
    assert page.errors == []
    assert page.run("document.querySelector('h1').textContent") == f"Map of {NASTY}"
