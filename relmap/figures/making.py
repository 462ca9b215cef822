"""All figures: run them and write pictures, data, verdicts and one self-contained page.

The page has claim, finding and verdict of each side by side.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.errors import RelmapError
from relmap.figures import (
    figure04,
    figure05,
    figure06,
    figure07,
    figure09_11,
    figure12,
    figure13,
    figure14_15,
    figure16,
    figure17,
)
from relmap.figures.base import Outcome, PaperFigure, Table, Watch
from relmap.io.files import atomic_write
from relmap.plots.html import document
from relmap.plots.sheet import write_png
from relmap.recorded import versions

SKIPPED = "not run"
DENSITY = 1.5
"""Pixels of a picture per pixel of the page."""
STYLE = """
td:first-child, td.verdict { white-space: nowrap; }
.beside { display: grid; grid-template-columns: 1fr 1fr auto; gap: 1.5rem; margin-bottom: 1rem; }
.beside h3 { font-size: .85rem; margin: 0; color: #5f6670; text-transform: uppercase;
  letter-spacing: .04em; }
.badge { display: inline-block; border-radius: .3rem; padding: .1rem .6rem; font-weight: 600;
  white-space: nowrap; }
.yes { background: #d9f0dd; color: #14532d; }
.partly { background: #fdeec6; color: #6b4400; }
.no { background: #fadbd8; color: #7a1c12; }
.none { background: #e8eaed; color: #3f464e; }
@media (max-width: 50rem) { .beside { grid-template-columns: 1fr; gap: .6rem; } }
"""
BADGES = {"borne out": "yes", "partly borne out": "partly", "not borne out": "no", SKIPPED: "none"}
FIGURES: tuple[PaperFigure[Any], ...] = (
    figure04.FIGURE,
    figure05.FIGURE,
    figure06.FIGURE,
    *figure07.FIGURES,
    *figure09_11.FIGURES,
    figure12.FIGURE,
    figure13.FIGURE,
    *figure14_15.FIGURES,
    figure16.FIGURE,
    figure17.FIGURE,
)
"""In the paper's order."""
NEEDS_DATA = "17"
NO_DATA = "needs the Victoria Park data: give their folder with --data PATH"


@dataclass(frozen=True, eq=False)
class Made:
    """A figure with its outcome, or None with the reason in `note`, and its written files."""

    figure: PaperFigure[Any]
    outcome: Outcome | None
    note: str = ""
    files: tuple[str, ...] = ()
    picture: bytes = b""


def page(entries: Sequence[Made], quick: bool) -> str:
    """Return the page of figures as HTML with everything in it; `quick`: whether runs are small."""
    small = "small runs (--quick): figures and verdicts of the full size may differ"
    size = small if quick else "runs of full size"
    said = ", ".join(f"{name} {version}" for name, version in versions().items())
    title = "The paper's figures from runs of relmap"
    names = ("figure", "shows", "our figure", "meaning", "the claim is")
    head = f"<tr>{''.join(f'<th>{name}</th>' for name in names)}</tr>"
    body = [
        f"<h1>{title}</h1>",
        "<p>What &ldquo;A Relative Mapping Algorithm&rdquo; claims with each figure, the "
        "result of this software, and whether the claim is borne out by the criterion below each "
        "figure, computed from the data.</p>",
        f'<p class="small">{escape(size)}. {escape(said)}. Times are processor time of one '
        "machine.</p>",
        f"<table><thead>{head}</thead><tbody>{''.join(map(_row, entries))}</tbody></table>",
        *map(_section, entries),
    ]
    return document(title, body, STYLE)


def _badge(entry: Made) -> str:
    verdict = SKIPPED if entry.outcome is None else entry.outcome.verdict
    return f'<span class="badge {BADGES[verdict]}">{escape(verdict)}</span>'


def _row(entry: Made) -> str:
    figure, found = entry.figure, entry.outcome
    value, unit = ("", entry.note) if found is None else (f"{found.value:.3g}", figure.unit)
    return (
        f'<tr><td><a href="#f{figure.name}">{escape(figure.heading)}</a></td>'
        f"<td>{escape(figure.title)}</td><td>{value}</td><td>{escape(unit)}</td>"
        f'<td class="verdict">{_badge(entry)}</td></tr>'
    )


def _section(entry: Made) -> str:
    figure, outcome = entry.figure, entry.outcome
    ours = entry.note if outcome is None else outcome.ours
    named = escape(f"{figure.heading}: {figure.title}")
    parts = [
        f'<section id="f{figure.name}"><h2>{named}</h2>',
        f'<div class="beside"><div><h3>The paper</h3><p>{escape(figure.claim)}</p></div>',
        f"<div><h3>relmap</h3><p>{escape(ours)}</p></div>",
        f"<div><h3>The claim is</h3><p>{_badge(entry)}</p></div></div>",
        f'<p class="small">Borne out where: {escape(figure.criterion)}.</p>',
    ]
    if outcome is not None:
        picture = b64encode(entry.picture).decode()
        names = ", ".join(f"<code>{escape(name)}</code>" for name in entry.files)
        # The header of a PNG holds its width, big-endian, after 16 bytes.
        width = round(int.from_bytes(entry.picture[16:20], "big") / DENSITY)
        parts.append(f'<img alt="{named}" width="{width}" src="data:image/png;base64,{picture}">')
        parts.append(f'<p class="small">Beside this page: {names}</p>')
    return "".join([*parts, "</section>"])


def chosen_figures(names: Sequence[str]) -> list[PaperFigure[Any]]:
    """Return the figures of these names in the paper's order, each once.

    `names`: if empty, all figures of the paper. Raises `RelmapError` if there is no such figure.
    """
    if not names:
        return [figure for figure in FIGURES if figure.name.isdigit()]
    wanted = {name.lstrip("0"): name for name in names}
    for bare, name in wanted.items():
        if bare in ("1", "2", "3", "8"):
            raise RelmapError(
                f"figure {name} of the paper is a sketch without results; "
                "those with results are 4 to 7 and 9 to 17"
            )
        if bare not in [figure.name for figure in FIGURES]:
            raise RelmapError(f"no figure {name!r}; figures are 4 to 7, 9 to 17, and crossing")
    return [figure for figure in FIGURES if figure.name in wanted]


def check_data(figures: Sequence[PaperFigure[Any]], data: Path | None) -> None:
    """Raise RelmapError if real data are damaged or not used, or nothing can be run without."""
    names = [figure.name for figure in figures]
    if data is not None:
        if NEEDS_DATA not in names:
            raise RelmapError(f"--data is for figure {NEEDS_DATA}, which is not among those given")
        figure17.victoria_park(data)
    elif names == [NEEDS_DATA]:
        raise RelmapError(f"figure {NEEDS_DATA} {NO_DATA}")


def make_figure(
    figure: PaperFigure[Any], folder: Path, quick: bool, data: Path | None, watch: Watch
) -> Made:
    """Run a figure and write its picture and data; if the run fails, the note gives the reason."""
    if data is None and figure.name == NEEDS_DATA:
        return Made(figure, None, NO_DATA)
    try:
        found = figure.run(quick, data, watch)
        outcome = figure.judge(found)
    except (RelmapError, RuntimeError, np.linalg.LinAlgError) as error:
        return Made(figure, None, "failed: " + " ".join(str(error).split())[:200])
    picture = folder / f"{figure.stem}.png"
    write_png(picture, figure.draw, found)
    outcome.table.write(picture.with_suffix(".csv"))
    for ending, write in outcome.more.items():
        write(folder / f"{figure.stem}{ending}")
    files = sorted(path.name for path in folder.glob(f"{figure.stem}*"))
    return Made(figure, outcome, files=tuple(files), picture=picture.read_bytes())


def write_page(folder: Path, made: Sequence[Made], quick: bool) -> None:
    """Write the page, index.html, and the table of verdicts, verdicts.csv."""
    done = [(each.figure.name, each.outcome) for each in made if each.outcome is not None]
    rows = [(name, found.value, found.verdict, found.ours) for name, found in done]
    Table(("figure", "value", "verdict", "finding"), rows).write(folder / "verdicts.csv")
    atomic_write(folder / "index.html", page(made, quick))
