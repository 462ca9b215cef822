"""The HTML report of a run: interactive map, replay, figures, and provenance."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from html import escape
from importlib.resources import files
from typing import Any

from relmap.io.results import Result
from relmap.planes.walls.files import PlaneResult
from relmap.planes3d.files import Plane3dResult
from relmap.plots.html import document, table
from relmap.plots.report_data import views_of

LISTED = 12
"""Maximum number of submaps listed."""
UNSAFE = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}
"""Characters that must be escaped in a script."""
MAP = """
<div id="bar"><select id="view" aria-label="submap"></select>
<button id="side" type="button" hidden>from the side</button>
<span class="gap"></span>
<button id="in" type="button" aria-label="zoom in">+</button>
<button id="out" type="button" aria-label="zoom out">&minus;</button>
<button id="whole" type="button">whole map</button></div>
<div id="frame"><canvas id="map" tabindex="0" aria-label="the map from above"></canvas>
<div id="scale"></div></div>
<div id="replay"><button id="play" type="button">play</button>
<input id="time" type="range" min="0" max="0" value="0" aria-label="time"></div>
<p class="small" id="now" aria-live="off"></p>
<p class="small" id="under">drag to move, wheel or pinch to zoom</p>
<p class="small" id="legend"></p>
<noscript><p>The map needs JavaScript; map.png beside this page shows it too.</p></noscript>
"""


def report_page(result: Result, command: str, name: str) -> str:
    """Return the page of a finished run, with everything in it.

    `result`: as `relmap.evaluation.run.run_mapper` returns it; `command`: command that repeats the
    run; `name`: name of the log. The same run gives the same page.
    """
    summary = result.summary
    data = json.dumps(views_of(result), allow_nan=False, separators=(",", ":")).translate(UNSAFE)
    body = [
        f"<h1>Map of {escape(name)}</h1>",
        f"<p>{escape(_caption(result))}</p>",
        MAP,
        *_sections(summary),
        "<section><h2>How it was made</h2>",
        f"<p><code>{escape(command)}</code></p>",
        table((), _made(summary)),
        "</section>",
        f'<script id="data" type="application/json">{data}</script>',
        f"<script>{_resource('report.js')}</script>",
    ]
    return document(f"Map of {name}", body, _resource("report.css"))


def _resource(name: str) -> str:
    return files("relmap.plots").joinpath(name).read_text(encoding="utf-8")


def _caption(result: Result) -> str:
    """Return a one-sentence description of the map."""
    counts, n = result.summary["counts"], len(result.summary["submaps"])
    what = f"{counts.get('mapped')} of {counts.get('landmarks')} landmarks"
    if isinstance(result, PlaneResult):
        what = f"{counts['planes_static']} walls with {counts['corners_static']} corners"
    if isinstance(result, Plane3dResult):
        what = f"{counts['planes_static']} planes, shown with their floor level"
    early = ", stopped early" if result.summary["interrupted"] else ""
    apart = f"; the run broke into {n} submaps, each in its own frame" if n > 1 else ""
    return f"{what}, mapped in {counts['iterations']} iterations{early}{apart}."


def _sections(summary: Mapping[str, Any]) -> Iterator[str]:
    yield "<section><h2>Results</h2>"
    yield table((), [*_flat(summary["counts"]), *_flat(summary.get("association_trust", {}))])
    yield "</section>"
    submaps = summary["submaps"]
    if len(submaps) > 1:
        head = ["submap", *(name.replace("_", " ") for name in submaps[0])]
        rows = [[k, *map(_cell, submap.values())] for k, submap in enumerate(submaps[:LISTED])]
        more = len(submaps) - LISTED
        yield f"<section><h2>Submaps</h2>{table(head, rows)}"
        yield f"<p>and {more} more</p></section>" if more > 0 else "</section>"
    refinement = summary.get("refinement")
    if refinement is not None:
        plain = {key: value for key, value in refinement.items() if not isinstance(value, list)}
        yield f"<section><h2>Refinement</h2>{table((), _flat(plain))}"
        yield '<p class="small">Residuals are relative to what the noise explains.</p></section>'
    if "weak_links" in summary:
        yield '<section id="weak"><h2>Weak links</h2><p class="small">Scans that show too little to'
        yield " determine the motion since the previous scan: these steps may be wrong.</p>"
        yield '<p id="links"></p></section>'


def _made(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key in ("format", "variant", "association", "dimensions", "scans", "seed", "refined"):
        yield key, _cell(summary.get(key))
    yield from _flat(summary["configuration"])
    yield from _flat(summary["versions"])


def _flat(content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        yield key.replace("_", " "), _cell(value)


def _cell(value: Any) -> str:
    """Return a value in readable form."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return " to ".join(map(str, value)) if len(value) == 2 else ", ".join(map(str, value))
    return str(value)
