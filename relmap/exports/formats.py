"""The export formats, and how each is written."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from relmap.core.errors import RelmapError
from relmap.datasets.textfile import shown
from relmap.exports.content import MapContent, read_content
from relmap.exports.drawings import dxf_text, geojson_text, map_ply, svg_text
from relmap.exports.grid import grid_of, pgm_bytes, yaml_text
from relmap.exports.posegraph import g2o_text
from relmap.exports.sight import sight_lines, sightings
from relmap.io.files import atomic_write, staged_folder

RESOLUTION_M = 0.05
NAME = "map"
"""Name of a file that is written into a folder."""

Rendered = tuple[dict[str, str | bytes], str]
"""File contents by name, and a message that describes them."""
Render = Callable[[Path, MapContent, Path | None, float], Rendered]
"""From the path of a file, the map, the log that was mapped, if given, and the size of a cell."""


def export(
    result: Path, to: str, out: Path, log: Path | None = None, resolution_m: float = RESOLUTION_M
) -> str:
    """Export the map of a result folder.

    `to`: one of `FORMATS`. `out`: the file; or a folder, which has no extension or exists already.
    `log`: the log that was mapped, for free space and measurements; `resolution_m`: of a grid.
    Returns a message about the written files. Raises `RelmapError` if the result or the log is
    invalid, the map does not fit the format, or the file cannot be written.
    """
    endings, render = FORMATS[to]
    path = out / f"{NAME}{endings[0]}" if os.path.isdir(out) or not out.suffix else out
    if path.suffix.lower() not in endings:
        ends = " or ".join(endings)
        raise RelmapError(f"--to {to} writes {ends}, and {shown(out)} ends otherwise")
    files, description = render(path, read_content(result), log, resolution_m)
    with staged_folder(path.parent) as staging:
        for name, held in files.items():
            atomic_write(staging / name, held)
    names = " and ".join(str(path.with_name(name)) for name in files)
    return f"wrote {names}: {description}"


def _text(text: Callable[[MapContent], str]) -> Render:
    def render(path: Path, content: MapContent, *_: object) -> Rendered:
        return {path.name: text(content)}, content.description

    return render


def _g2o(path: Path, content: MapContent, log: Path | None, _: float) -> Rendered:
    if content.walls is not None:
        return {path.name: g2o_text(content, None)}, f"{len(content.result.poses)} poses"
    seen = sightings(content, log)
    description = "" if seen is None else f", {len(seen.pose)} observations"
    if seen is not None and seen.points_robot is None:
        description += " computed from the map: give --log LOG for the measured ones"
    return {path.name: g2o_text(content, seen)}, content.description + description


def _ply(path: Path, content: MapContent, *_: object) -> Rendered:
    things = f"{len(content.landmarks.landmark)} landmarks"
    if content.walls is not None:
        things = f"{len(content.walls.plane)} walls"
    return {path.name: map_ply(content)}, things


def _grid(path: Path, content: MapContent, log: Path | None, resolution_m: float) -> Rendered:
    lines = sight_lines(content, log)
    grid = grid_of(content, lines, resolution_m)
    rows, columns = grid.pixels.shape
    description = f"{columns} x {rows} cells of {grid.resolution_m:g} m, "
    needs = "free space needs mapper.npz in the result folder, or --log LOG"
    unknown = f"all unknown except the map: {needs}"
    description += unknown if lines is None else f"free space from {len(lines[0])} beams"
    picture, about = path.with_suffix(".pgm").name, path.with_suffix(".yaml").name
    return {picture: pgm_bytes(grid), about: yaml_text(picture, grid)}, description


FORMATS: dict[str, tuple[tuple[str, ...], Render]] = {
    "grid": ((".yaml", ".pgm"), _grid),
    "dxf": ((".dxf",), _text(dxf_text)),
    "svg": ((".svg",), _text(svg_text)),
    "geojson": ((".geojson", ".json"), _text(geojson_text)),
    "g2o": ((".g2o",), _g2o),
    "ply": ((".ply",), _ply),
}
"""Accepted extensions of each format, of which the first is the default, and its writer."""
