"""The page of a run in a browser, where there is one."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from relmap.cli import main
from tests.browser import Page, browser, found
from tests.commands import load, table
from tests.everyformat import NASTY, Mapped

pytestmark = pytest.mark.usefixtures("unrendered")


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
