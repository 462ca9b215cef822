"""GeoJSON of walls or landmarks, with the columns of a result's tables."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from relmap.exports.content import MapContent
from relmap.planes.walls.files import CORNER, OPEN

FRAME = "local: x and y in metres in the frame of the map, not longitude and latitude (WGS 84)"
"""RFC 7946 only allows WGS 84, so the file states its frame."""


def geojson_text(content: MapContent) -> str:
    """Return a map as a FeatureCollection with a member `frame`.

    Walls are LineStrings from the right to the left end, corners and landmarks Points, the path is
    a MultiLineString.
    """
    axes = 2 if content.result.planar else 3
    pieces = [piece[:, :axes].tolist() for piece in content.path]
    about = {"kind": "path", "poses": len(content.result.poses)}
    path = _feature("MultiLineString", pieces, about)
    features = [*_walls(content), *_landmarks(content), path]
    whole = {"type": "FeatureCollection", "frame": FRAME, "features": features}
    return json.dumps(whole, allow_nan=False, indent=1) + "\n"


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    known = {name: None if value != value else value for name, value in properties.items()}
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": known}


def _walls(content: MapContent) -> Iterator[dict[str, Any]]:
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


def _landmarks(content: MapContent) -> Iterator[dict[str, Any]]:
    table = content.landmarks
    kind = "landmark" if content.walls is None else "corner"
    names = ("landmark", "sd", "observations", "first_iteration", "last_iteration", "status")
    axes = 2 if content.result.planar else 3
    for row, position in enumerate(table.position[:, :axes].tolist()):
        properties = {name: getattr(table, name)[row].item() for name in names}
        yield _feature("Point", position, {"kind": kind} | properties)
