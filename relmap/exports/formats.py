"""The export formats, and how each is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from relmap.core.errors import RelmapError
from relmap.datasets.textfile import shown
from relmap.exports.content import MapContent, read_content
from relmap.exports.drawings import dxf_text, ply_text, svg_text
from relmap.exports.geojson import geojson_text
from relmap.exports.grid import grid_of, pgm_bytes, yaml_text
from relmap.exports.posegraph import g2o_text
from relmap.exports.sight import sight_lines, sightings
from relmap.io.files import atomic_write, staged_folder

RESOLUTION_M = 0.05
NAME = "map"
"""Name of a file that is written into a folder."""


@dataclass(frozen=True)
class Order:
    """What to export, and how.

    `result`: the result folder; `log`: the log that was mapped, for free space and measurements;
    `resolution_m`: size of a cell of a grid.
    """

    result: Path
    log: Path | None = None
    resolution_m: float = RESOLUTION_M


Files = dict[str, str | bytes]
"""File contents by name."""
Rendered = tuple[Files, str]
"""Files, and a message that describes them."""


@dataclass(frozen=True)
class Format:
    """An export format.

    `endings`: accepted extensions; the first is the default. `render`: returns the files of a map
    for a given path.
    """

    endings: tuple[str, ...]
    render: Callable[[Path, MapContent, Order], Rendered]


def export(order: Order, to: str, out: Path) -> str:
    """Export the map of a result folder.

    `to`: one of `FORMATS`. `out`: the file; or a folder, which has no extension or exists already.
    Returns a message about the written files. Raises `RelmapError` if the result or the log is
    invalid, the map does not fit the format, or the file cannot be written.
    """
    form = FORMATS[to]
    path = out / f"{NAME}{form.endings[0]}" if out.is_dir() or not out.suffix else out
    if path.suffix.lower() not in form.endings:
        endings = " or ".join(form.endings)
        raise RelmapError(f"--to {to} writes {endings}, and {shown(out)} ends otherwise")
    files, description = form.render(path, read_content(order.result), order)
    with staged_folder(path.parent) as staging:
        for name, held in files.items():
            atomic_write(staging / name, held)
    names = " and ".join(str(path.with_name(name)) for name in files)
    return f"wrote {names}: {description}"


def _text(text: Callable[[MapContent], str]) -> Callable[[Path, MapContent, Order], Rendered]:
    return lambda path, content, order: ({path.name: text(content)}, content.description)


def _svg(path: Path, content: MapContent, order: Order) -> Rendered:
    return {path.name: svg_text(content, order.result.resolve().name)}, content.description


def _g2o(path: Path, content: MapContent, order: Order) -> Rendered:
    if content.walls is not None:
        return {path.name: g2o_text(content, None)}, f"{len(content.result.poses)} poses"
    seen = sightings(order.result, content, order.log)
    description = "" if seen is None else f", {len(seen.pose)} observations"
    if seen is not None and seen.points_robot is None:
        description += " computed from the map: give --log LOG for the measured ones"
    return {path.name: g2o_text(content, seen)}, content.description + description


def _ply(path: Path, content: MapContent, order: Order) -> Rendered:
    things = f"{len(content.landmarks.landmark)} landmarks"
    if content.walls is not None:
        things = f"{len(content.walls.plane)} walls"
    return {path.name: ply_text(content)}, things


def _grid(path: Path, content: MapContent, order: Order) -> Rendered:
    lines = sight_lines(order.result, content, order.log)
    grid = grid_of(content, lines, order.resolution_m)
    rows, columns = grid.pixels.shape
    description = f"{columns} x {rows} cells of {grid.resolution_m:g} m, "
    needs = "free space needs mapper.npz in the result folder, or --log LOG"
    unknown = f"all unknown except the map: {needs}"
    description += unknown if lines is None else f"free space from {len(lines[0])} beams"
    picture, about = path.with_suffix(".pgm").name, path.with_suffix(".yaml").name
    return {picture: pgm_bytes(grid), about: yaml_text(picture, grid)}, description


FORMATS = {
    "grid": Format((".yaml", ".pgm"), _grid),
    "dxf": Format((".dxf",), _text(dxf_text)),
    "svg": Format((".svg",), _svg),
    "geojson": Format((".geojson", ".json"), _text(geojson_text)),
    "g2o": Format((".g2o",), _g2o),
    "ply": Format((".ply",), _ply),
}
