"""The HTML report of a run: interactive map, replay, figures, and provenance.

Arrays in its data are little-endian, in base 64: float32, int32, and uint16 for the points of
scans.
"""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator, Mapping
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats, Ints
from relmap.io.results import LEAST_SCANS, Result, SubmapPath
from relmap.planes.walls.files import DrawnSubmap, PlaneResult
from relmap.planes.walls.table import PlaneTable
from relmap.planes3d.files import Plane3dResult
from relmap.planes3d.table import Plane3dTable, is_mapped
from relmap.plots.html import document, table
from relmap.plots.path import jumps
from relmap.plots.planes import upward
from relmap.plots.run import weak_places
from relmap.plots.sheet import limits_of

View = dict[str, Any]
LISTED = 12
"""Maximum number of submaps listed."""
POINTS = 60_000
"""Maximum number of scan points in the report, over all submaps."""
STEPS = 65_535
"""Quantisation steps over the range of the scan points' coordinates."""
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
        value = summary.get(key)
        # As --scans takes them: the second number is beyond the last scan.
        yield key, ":".join(map(str, value)) if key == "scans" and value else _cell(value)
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


def views_of(result: Result) -> list[View]:
    """Return the data of each submap in its own frame, the map itself first."""
    if isinstance(result, PlaneResult):
        total = sum(len(submap.points) for submap in result.drawn)
        every = max(-(-total // POINTS), 1)
        return [_view_of_walls(k, submap, every) for k, submap in enumerate(result.drawn)]
    if isinstance(result, Plane3dResult):
        return [
            _view_of_planes(result, rank)
            for rank, path in enumerate(result.paths)
            if rank == 0 or len(path.poses) >= LEAST_SCANS
        ]
    others = zip(result.submaps[1:], result.paths[1:], strict=True)
    return [
        _view_of_map(result),
        *(
            _view_of_points(k, submap.positions, submap.landmark_ids, path, result.planar)
            for k, (submap, path) in enumerate(others, start=1)
        ),
    ]


def _view_of_walls(number: int, submap: DrawnSubmap, every: int) -> View:
    planes = submap.planes
    mapped = planes.status == "static"
    ends = planes.ends[mapped]
    wall, end = np.nonzero(planes.corner[mapped] >= 0)
    first = np.searchsorted(submap.iterations, planes.first_iteration[mapped])
    caption = f"{len(submap.poses)} scans, {len(ends)} walls, {len(wall)} corners"
    return {
        **_framed(number, caption, ends.reshape(-1, 2), submap.poses[:, :2, 3]),
        **_lines(ends, planes, np.flatnonzero(mapped), submap.iterations),
        "dots": _packed(ends[wall, end], "<f4"),
        "dotFirst": _packed(first[wall], "<i4"),
        **_path(submap.iterations, submap.stamps_s, submap.poses, 2),
        "weak": submap.weak.tolist(),
        **_points(submap.points[::every], submap.point_scan[::every]),
    }


def _view_of_planes(result: Plane3dResult, rank: int) -> View:
    """Return the edges of the planes of a submap, with its floor level."""
    planes, (iterations, stamps_s, poses) = result.planes, result.paths[rank]
    part, own = result.parts[rank], np.flatnonzero(planes.submap == rank)
    rows = own[is_mapped(part)[np.argsort(part.number, kind="stable")]].tolist()
    level = np.eye(4)
    level[:3, :3] = up = upward(planes, rows)
    rings = [planes.outline[k] @ up.T for k in rows]
    edges = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings]
    ends = np.concatenate([np.empty((0, 2, 3)), *edges])
    of = np.repeat(np.array(rows, dtype=np.int64), [len(ring) for ring in rings])
    weak = np.flatnonzero(np.isin(iterations, result.summary["weak_links"]))
    caption = f"{len(poses)} scans, {len(rows)} planes"
    return {
        **_framed(rank, caption, ends.reshape(-1, 3), (level @ poses)[:, :3, 3]),
        **_lines(ends, planes, of, iterations),
        **_path(iterations, stamps_s, level @ poses, 3),
        "weak": weak[weak > 0].tolist(),
    }


def _view_of_map(result: Result) -> View:
    table, kept, iterations = result.landmarks, result.mapped, result.iterations
    assert iterations is not None
    path = SubmapPath(iterations, result.stamps_s, result.poses)
    view = _view_of_points(0, table.position[kept], table.landmark[kept], path, result.planar)
    return view | {
        "dotSeen": _packed(table.observations[kept], "<i4"),
        "dotFirst": _packed(np.searchsorted(iterations, table.first_iteration[kept]), "<i4"),
        "rings": [
            {"name": name, "at": _packed(at[:, : view["axes"]], "<f4")}
            for name, at in weak_places(result).items()
            if len(at)
        ],
    }


def _view_of_points(
    number: int, places: Floats, labels: Ints, path: SubmapPath, planar: bool
) -> View:
    axes = 2 if planar else 3
    caption = f"{len(path.poses)} poses, {len(places)} landmarks"
    return {
        **_framed(number, caption, places[:, :axes], path.poses[:, :axes, 3]),
        "dots": _packed(places[:, :axes], "<f4"),
        "dotNames": _packed(labels, "<i8"),
        **_path(*path, axes),
    }


def _framed(number: int, caption: str, places: Floats, way: Floats) -> View:
    """Return name, caption, axes and first limits of a view of places (n, d) and a path (k, d)."""
    name = f"submap {number}" if number else "map"
    limits = [limit.tolist() for limit in limits_of(places, way)]
    return {"name": name, "caption": caption, "axes": places.shape[1], "limits": limits}


def _lines(ends: Floats, table: PlaneTable | Plane3dTable, rows: Ints, iterations: Ints) -> View:
    """Return lines (n, 2, d), each of a plane in a row (n,) of the table."""
    first = np.searchsorted(iterations, table.first_iteration[rows])
    return {
        "lines": _packed(ends, "<f4"),
        "lineNames": _packed(table.plane[rows], "<i4"),
        "lineSeen": _packed(table.observations[rows], "<i4"),
        "lineFirst": _packed(first, "<i4"),
    }


def _path(iterations: Ints, stamps_s: Floats, poses: NDArray[Any], axes: int) -> View:
    """Return positions and headings of the robot, their times, and where the path jumps."""
    position = poses[:, :axes, 3]
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    timed = np.isfinite(stamps_s).all() and not np.array_equal(stamps_s, iterations)
    return {
        "path": _packed(position, "<f4"),
        "yaw": _packed(yaw, "<f4"),
        "iterations": _packed(iterations, "<i4"),
        "stamps": _packed(stamps_s, "<f8") if timed else None,
        "leaps": (1 + np.flatnonzero(jumps(position))).tolist(),
    }


def _points(points: Floats, scan: Ints) -> View:
    """Return quantised points with their range, and the scan of each."""
    if not len(points):
        return {}
    low, high = points.min(axis=0), points.max(axis=0)
    step = np.maximum((high - low) / STEPS, 1e-9)
    return {
        "points": _packed(np.rint((points - low) / step), "<u2"),
        "pointLow": low.tolist(),
        "pointStep": step.tolist(),
        # The scan numbers ascend, so the first point of each scan is sufficient.
        "pointFrom": _packed(np.searchsorted(scan, np.arange(int(scan[-1]) + 2)), "<i4"),
    }


def _packed(values: NDArray[Any], kind: str) -> str:
    return b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode()
