"""Maps for drawing programs: floor plans as DXF (R12), SVG, GeoJSON; walls, landmarks as PLY."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from relmap.core.arrays import Floats
from relmap.exports.content import MapContent
from relmap.io.results import ply_text
from relmap.planes.walls.files import CORNER, OPEN

LAYERS = {"WALLS": 5, "CORNERS": 3, "LANDMARKS": 7, "PATH": 8}
"""Layers of a DXF file, and their colours by AutoCAD's index."""
SVG_PX = 1000
"""Length of the longer side of an SVG picture."""
SVG_STYLE = (
    "line{stroke:#1f4e9e}.corner{fill:#0b7a3b}.landmark{fill:#222}"
    "polyline{fill:none;stroke:#7f7f7f}line,polyline{vector-effect:non-scaling-stroke;"
    "stroke-width:1.5px;stroke-linecap:round}"
)
DOT = 0.002
"""Radius of a dot, relative to the longer side of the picture."""
Tags = Iterator[tuple[int, object]]
FRAME = "local: x and y in metres in the frame of the map, not longitude and latitude (WGS 84)"
"""RFC 7946 only allows WGS 84, so the file states its frame."""


def dxf_text(content: MapContent) -> str:
    """Return a map as DXF R12, which every drawing program reads; a unit is a metre.

    A wall is a LINE from its right end to its left one, as high as the wall (its thickness, in the
    words of DXF) where that is known.  Corners, or landmarks, are POINTs, the path is a POLYLINE.
    """
    places = content.places
    low, high = (f(axis=0) if len(places) else np.zeros(3) for f in (places.min, places.max))
    tags: list[tuple[int, object]] = [(999, "relmap: map frame, metres")]
    tags += [(0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009")]
    for name, corner in (("$EXTMIN", low), ("$EXTMAX", high)):
        tags += [(9, name), *_at(10, corner)]
    tags += [(0, "ENDSEC"), (0, "SECTION"), (2, "TABLES")]
    tags += [(0, "TABLE"), (2, "LAYER"), (70, len(LAYERS))]
    for name, colour in LAYERS.items():
        tags += [(0, "LAYER"), (2, name), (70, 0), (62, colour), (6, "CONTINUOUS")]
    tags += [(0, "ENDTAB"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    tags += [*_walls(content), *_dots(content), *_path(content), (0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code}\n{value}\n" for code, value in tags)


def _at(code: int, place: Floats) -> Tags:
    """Yield x, y and z of a position (3,), with group codes that differ by ten."""
    for axis, value in enumerate(place.tolist()):
        yield code + 10 * axis, repr(value + 0.0)


def _walls(content: MapContent) -> Tags:
    if content.walls is None:
        return
    for ends, (z0, z1) in zip(content.walls.ends, content.walls.z_extent.tolist(), strict=True):
        yield from [(0, "LINE"), (8, "WALLS")]
        if z1 > z0:
            yield 39, repr(z1 - z0)
        for code, end in zip((10, 11), ends, strict=True):
            yield from _at(code, np.append(end, z0))


def _dots(content: MapContent) -> Tags:
    layer = "LANDMARKS" if content.walls is None else "CORNERS"
    for position in content.landmarks.position:
        yield from [(0, "POINT"), (8, layer), *_at(10, position)]


def _path(content: MapContent) -> Tags:
    for piece in content.path:
        yield from [(0, "POLYLINE"), (8, "PATH"), (66, 1), *_at(10, np.zeros(3)), (70, 8)]
        for position in piece:
            yield from [(0, "VERTEX"), (8, "PATH"), *_at(10, position), (70, 32)]
        yield from [(0, "SEQEND"), (8, "PATH")]


def svg_text(content: MapContent) -> str:
    """Return a map from above as SVG: a user unit is a metre, and y points down, so -y is drawn."""
    places = content.places[:, :2]
    low, high = (f(axis=0) if len(places) else np.zeros(2) for f in (places.min, places.max))
    longest = max(float((high - low).max()), 1e-3)
    rim = 0.03 * longest
    wide, tall = (high - low + 2 * rim).tolist()
    left, top = float(low[0] - rim), float(-high[1] - rim)
    scale = SVG_PX / max(wide, tall)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide * scale:.0f}" '
        f'height="{tall * scale:.0f}" viewBox="{left!r} {top!r} {wide!r} '
        f'{tall!r}">\n<title>{escape(content.folder.resolve().name)}</title>\n'
        f"<desc>{content.description}; map frame, metres, y drawn as -y</desc>\n"
        f"<style>{SVG_STYLE}</style>\n" + "".join(_shapes(content, DOT * longest)) + "</svg>\n"
    )


def _shapes(content: MapContent, radius: float) -> Iterable[str]:
    for piece in content.path:
        points = " ".join(f"{x!r},{-y!r}" for x, y in piece[:, :2].tolist())
        yield f'<polyline class="path" points="{points}"/>\n'
    if content.walls is not None:
        for plane, ends in zip(content.walls.plane, content.walls.ends.tolist(), strict=True):
            (x0, y0), (x1, y1) = ends
            where = f'x1="{x0!r}" y1="{-y0!r}" x2="{x1!r}" y2="{-y1!r}"'
            yield f'<line class="wall" id="wall-{plane}" {where}/>\n'
    kind, table = "landmark" if content.walls is None else "corner", content.landmarks
    for label, (x, y, _) in zip(table.landmark, table.position.tolist(), strict=True):
        where = f'cx="{x!r}" cy="{-y!r}" r="{radius:.4g}"'
        yield f'<circle class="{kind}" id="{kind}-{label}" {where}/>\n'


def map_ply(content: MapContent) -> str:
    """Return a map as ASCII PLY in full precision.

    A wall has an edge along its foot and, if its height is known, a face with the same front.
    Landmarks are vertices only.
    """
    vertices = content.landmarks.position
    edges, faces = np.empty((0, 2), int), np.empty((0, 4), int)
    if content.walls is not None:
        ends, z = content.walls.ends, content.walls.z_extent
        foot, head = (np.dstack([ends, np.repeat(z[:, [k]], 2, axis=1)]) for k in (0, 1))
        n = len(ends)
        edges = np.arange(2 * n).reshape(n, 2)
        high = np.flatnonzero(z[:, 1] > z[:, 0])
        tops = 2 * n + np.arange(2 * len(high)).reshape(-1, 2)
        vertices = np.concatenate([foot.reshape(-1, 3), head[high].reshape(-1, 3)])
        # Seen from the front the right end comes first: left, right, and back along the top is
        # counter-clockwise.
        faces = np.column_stack([edges[high][:, ::-1], tops])
    return ply_text(vertices, edges, faces, "relmap: map frame, metres")


def geojson_text(content: MapContent) -> str:
    """Return a map as a FeatureCollection with a member `frame`.

    Walls are LineStrings from the right to the left end, corners and landmarks Points, the path is
    a MultiLineString.
    """
    axes = 2 if content.result.planar else 3
    pieces = [piece[:, :axes].tolist() for piece in content.path]
    about = {"kind": "path", "poses": len(content.result.poses)}
    path = _feature("MultiLineString", pieces, about)
    features = [*_wall_features(content), *_landmark_features(content), path]
    whole = {"type": "FeatureCollection", "frame": FRAME, "features": features}
    return json.dumps(whole, allow_nan=False, indent=1) + "\n"


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    known = {name: None if value != value else value for name, value in properties.items()}
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": known}


def _wall_features(content: MapContent) -> Iterator[dict[str, Any]]:
    walls = content.walls
    if walls is None:
        return
    for row, ends in enumerate(walls.ends.tolist()):
        z0, z1 = walls.z_extent[row].tolist()
        nx, ny = walls.normal[row].tolist()
        about: dict[str, Any] = {"kind": "wall", "plane": int(walls.plane[row])}
        about |= {"z0": z0, "z1": z1, "nx": nx, "ny": ny}
        for end, corner in enumerate(walls.corner[row].tolist()):
            about[f"end{end}"] = CORNER if corner >= 0 else OPEN
            about[f"corner{end}"] = corner if corner >= 0 else None
        for name in ("observations", "first_iteration", "last_iteration", "status"):
            about[name] = getattr(walls, name)[row].item()
        yield _feature("LineString", ends, about)


def _landmark_features(content: MapContent) -> Iterator[dict[str, Any]]:
    table = content.landmarks
    kind = "landmark" if content.walls is None else "corner"
    names = ("landmark", "sd", "observations", "first_iteration", "last_iteration", "status")
    axes = 2 if content.result.planar else 3
    for row, position in enumerate(table.position[:, :axes].tolist()):
        properties = {name: getattr(table, name)[row].item() for name in names}
        yield _feature("Point", position, {"kind": kind} | properties)
