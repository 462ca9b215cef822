"""One self-contained page of all figures: claim, finding and verdict side by side."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from relmap.figures.base import Outcome, PaperFigure
from relmap.plots.html import document
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


@dataclass(frozen=True, eq=False)
class Made:
    """A figure with its outcome, or None with the reason in `note`.

    `files` are the names of the written files, including the picture.
    """

    figure: PaperFigure[Any]
    outcome: Outcome | None
    note: str = ""
    files: tuple[str, ...] = ()
    picture: bytes = b""


def page(entries: Sequence[Made], quick: bool) -> str:
    """Return the page as HTML with everything in it.

    `entries`: in the order of the page; `quick`: whether the runs were small.
    """
    small = "small runs (--quick): figures and verdicts of the full size may differ"
    size = small if quick else "runs of full size"
    said = ", ".join(f"{name} {version}" for name, version in versions().items())
    title = "The paper's figures from runs of relmap"
    body = [
        f"<h1>{title}</h1>",
        "<p>What &ldquo;A Relative Mapping Algorithm&rdquo; claims with each figure, the "
        "result of this software, and whether the claim is borne out by the criterion below each "
        "figure, computed from the data.</p>",
        f'<p class="small">{escape(size)}. {escape(said)}. Times are processor time of one '
        "machine.</p>",
        _summary(entries),
        *map(_section, entries),
    ]
    return document(title, body, STYLE)


def _badge(entry: Made) -> str:
    verdict = SKIPPED if entry.outcome is None else entry.outcome.verdict
    return f'<span class="badge {BADGES[verdict]}">{escape(verdict)}</span>'


def _summary(entries: Sequence[Made]) -> str:
    names = ("figure", "shows", "our figure", "meaning", "the claim is")
    head = f"<tr>{''.join(f'<th>{name}</th>' for name in names)}</tr>"
    return f"<table><thead>{head}</thead><tbody>{''.join(map(_row, entries))}</tbody></table>"


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
    named = escape(f"{figure.heading}: {figure.title}", quote=True)
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
