"""``relmap figures``: the files and the page that it writes, and how it ends."""

from __future__ import annotations

import signal
import subprocess
import time
from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from relmap import RelmapError
from relmap.cli import main
from relmap.figures import making
from relmap.figures.base import Outcome
from relmap.figures.making import FIGURES, chosen_figures
from tests.commands import PATIENCE_S, RELMAP, Check, names, snapshot, table

VOID = {"img", "meta", "br"}
MADE = ["6", "9", "10", "11"]


class Page(HTMLParser):
    """Checks that tags close, and collects what the page holds and refers to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sections: list[str | None] = []
        self.images: list[str | None] = []
        self.references: list[str] = []
        self.tags: set[str] = set()
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.add(tag)
        self.references += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "data")]
        if tag == "section":
            self.sections.append(given["id"])
        if tag == "img":
            self.images.append(given["alt"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The partial wall and the point chart, and Victoria Park left out."""
    out = tmp_path_factory.mktemp("made") / "figures"
    assert main(["figures", *MADE, "17", "-o", str(out), "--quick"]) == 0
    return out


@pytest.fixture(scope="module")
def page(made: Path) -> Page:
    return Page((made / "index.html").read_text(encoding="utf-8"))


def test_pictures_and_tables_are_written(made: Path) -> None:
    files = [f"figure{int(n):02d}.{kind}" for n in MADE for kind in ("csv", "png")]
    assert names(made) == sorted([*files, "figure11-seeds.csv", "index.html", "verdicts.csv"])
    rows = table(made / "verdicts.csv")
    assert [row["figure"] for row in rows] == MADE
    assert [row["verdict"] for row in rows][1:3] == ["borne out", "borne out"]


def test_table_of_the_group_is_its_area(made: Path) -> None:
    """Areas by brute force, from the table of visibility."""
    seen: dict[int, set[int]] = {}
    for row in table(made / "figure10.csv"):
        seen.setdefault(int(row["row"]), set()).add(int(row["iteration"]))
    areas = [n * len(set.intersection(*(seen[row] for row in range(n)))) for n in range(1, 38)]
    rows = table(made / "figure11.csv")
    assert [int(row["area"]) for row in rows] == areas
    members = sum(int(row["member"]) for row in rows)
    assert areas[members - 1] == max(areas[3:])


def test_page_holds_every_figure_once_in_order(page: Page) -> None:
    assert page.sections == [f"f{n}" for n in [*MADE, "17"]]
    assert [alt.split(":")[0] for alt in page.images if alt] == [f"Figure {n}" for n in MADE]


def test_page_needs_nothing_else(made: Path, page: Page) -> None:
    inside = {f"#{section}" for section in page.sections}
    pictures = [ref for ref in page.references if ref not in inside]
    assert page.tags & {"script", "link", "iframe", "object", "base"} == set()
    text = (made / "index.html").read_text(encoding="utf-8")
    assert "http" not in text.replace("http-equiv", "")
    assert "url(" not in text
    embedded = [b64decode(ref.removeprefix("data:image/png;base64,")) for ref in pictures]
    assert embedded == [(made / f"figure{int(n):02d}.png").read_bytes() for n in MADE]


def test_page_shows_claim_finding_and_verdict(page: Page) -> None:
    for figure in chosen_figures([*MADE, "17"]):
        assert figure.claim in page.text
        assert figure.criterion in page.text
    assert "small runs" in page.text
    assert page.text.count("not run") == 2  # in the list and beside the claim
    assert "give their folder with --data PATH" in page.text
    assert "partly borne out" in page.text  # of figure 6


def test_progress_and_verdicts_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["figures", "17", "9", "-o", str(out), "--quick"]) == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[0].startswith("figure 9: borne out. ")
    assert lines[1:] == [f"wrote index.html and 1 figure to {out}"]
    assert printed.err.startswith("relmap: figure 17 is skipped: it needs the Victoria Park data")


def test_same_figures_same_bytes(made: Path, tmp_path: Path) -> None:
    assert main(["figures", *MADE, "17", "-o", str(tmp_path), "--quick"]) == 0
    assert snapshot(tmp_path) == snapshot(made)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["18"], "no figure '18'; figures are 4 to 7, 9 to 17, and crossing"),
        (["9", "8"], "figure 8 of the paper is a sketch without results"),
        (["17"], "figure 17 needs the Victoria Park data"),
        (["9", "17", "--data", "nowhere"], "nowhere"),
        (["9", "17", "--data", "truth"], "truth"),
        (["9", "--data", "truth"], "--data is for figure 17"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments: list[str], said: str, refused: Check) -> None:
    assert said in refused("figures", *arguments, "-o", "out", "--quick")


def test_figures_that_cannot_be_written_change_nothing(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "out" / "index.html").mkdir()
    before = snapshot(place)
    assert main(["figures", "9", "-o", "out", "--quick"]) == 2
    assert "a folder of that name exists" in capsys.readouterr().err
    assert snapshot(place) == before


def test_ctrl_c_leaves_nothing_behind(tmp_path: Path, child_env: dict[str, str]) -> None:
    child = subprocess.Popen(
        [*RELMAP, "figures", "12", "-o", "out"], stderr=subprocess.PIPE, env=child_env, cwd=tmp_path
    )
    deadline = time.monotonic() + PATIENCE_S
    while not ((tmp_path / "out").is_dir() and names(tmp_path / "out")):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(0.5)
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 130
    assert errors == b"relmap: interrupted\n"
    assert names(tmp_path) == []


def fails(*_: object) -> Outcome:
    raise RelmapError("nothing was mapped")


def run_instead(monkeypatch: pytest.MonkeyPatch, number: str, run: Callable[..., Outcome]) -> None:
    """Replace the run of one of the figures."""
    changed = [replace(each, run=run) if each.name == number else each for each in FIGURES]
    monkeypatch.setattr(making, "FIGURES", tuple(changed))


def test_a_figure_that_fails_does_not_take_the_others_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_instead(monkeypatch, "10", fails)
    out = tmp_path / "out"
    assert main(["figures", "9", "10", "-o", str(out), "--quick"]) == 0
    assert names(out) == ["figure09.csv", "figure09.png", "index.html", "verdicts.csv"]
    printed = capsys.readouterr()
    assert printed.err == "relmap: figure 10 is skipped: it failed: nothing was mapped\n"
    assert "failed: nothing was mapped" in (out / "index.html").read_text()
    assert main(["figures", "10", "-o", str(tmp_path / "none"), "--quick"]) == 2
    assert capsys.readouterr().err.splitlines()[1:] == ["relmap: error: no figure could be made"]
    assert not (tmp_path / "none").exists()


def test_finished_figures_stay_when_ctrl_c_ends_the_run(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> Outcome:
        raise KeyboardInterrupt

    run_instead(monkeypatch, "10", interrupted)
    assert main(["figures", "9", "10", "-o", str(tmp_path), "--quick"]) == 130
    assert names(tmp_path) == ["figure09.csv", "figure09.png", "index.html", "verdicts.csv"]
    assert (tmp_path / "figure09.png").read_bytes() == (made / "figure09.png").read_bytes()
    assert Page((tmp_path / "index.html").read_text(encoding="utf-8")).sections == ["f9"]
