"""``planes.csv`` and ``map.ply`` of planes in space, and patches as a journal holds them.

The columns of a patch are those of `relmap.io.journal.layout`. ``cells`` has numbers of 8 bytes,
little-endian: `cell_m`, `reach_m`, the number of cells, `cells` and `cell_patch`, the latter a
whole number, and `loose`, all as in `relmap.segmentation.space.Patches`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from relmap.core.arrays import Bools, Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.shown import AXES, NORMAL
from relmap.io.files import atomic_write
from relmap.io.results import MAP_PLY, PLANES, Result, read_result
from relmap.io.tables import Kind, columns_text, read_columns
from relmap.planes3d.outlines import surfaces_of
from relmap.planes3d.submap import Submap
from relmap.planes3d.table import Plane3dTable
from relmap.segmentation.space import Patches

SDS = "sd", "sd_normal", "sd_centre"
COLUMNS: dict[str, Kind] = {
    "plane": "int",
    **dict.fromkeys((*NORMAL, "offset", *AXES, *SDS, "area_m2"), "float or empty"),
    **dict.fromkeys(("observations", "first_iteration", "last_iteration"), "int"),
    "status": "text",
    "submap": "int",
    "outline": "corners",
    "meets": "int list",
}
UNIT = 1e-3
"""Largest deviation of the length of a normal from 1."""
CODES = "4e79a7 f28e2b e15759 76b7b2 59a14f edc948 b07aa1 ff9da7 9c755f bab0ac"
COLOURS = np.array([list(bytes.fromhex(code)) for code in CODES.split()])
"""Colours of planes, by number modulo their count."""
ARRAYS = ("centre", "axes", "information", "spread", "cells", "loose")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Plane3dResult(Result):
    """A result whose landmarks are planes in space, at the mean of their points.

    Attributes
    ----------
    planes : Plane3dTable
        Iterations are numbered as in the log.
    parts : tuple of Submap
        The submaps, the map itself first; empty for a result read from files.
    weak : (w,) int64
        Indices in `poses` of the scans that are poorly determined in some direction.
    """

    planes: Plane3dTable
    parts: tuple[Submap, ...] = ()
    weak: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))


def write_parts(folder: Path, result: Plane3dResult) -> None:
    """Write the planes and the mesh into an existing folder.

    Outlines are written as ``x y z;x y z;...``, the planes that meet them as ``k;k;...``. Raises
    `RelmapError` if a file cannot be written.
    """
    table = result.planes
    corners = [[" ".join(f"{x:.4f}" for x in at) for at in each.tolist()] for each in table.outline]
    outlines = [";".join(each) for each in corners]
    meets = [";".join(map(str, meets.tolist())) for meets in table.meets]
    ragged = zip(("outline", "meets"), np.array([outlines, meets], dtype=object), strict=True)
    columns = table.columns() | dict(ragged)
    atomic_write(folder / PLANES, columns_text({name: columns[name] for name in COLUMNS}))
    write_mesh(folder, next(iter(result.parts), None), table.plane[table.status == "static"])


def read_result3d(folder: Path) -> Plane3dResult:
    """Read a result folder of planes in space; RelmapError if a file is missing or invalid."""
    table = read_columns(folder / PLANES, COLUMNS)
    for name in (*NORMAL, "offset", *AXES, "area_m2"):
        _require(folder, table, ~np.isnan(table[name]), f"its field {name} is empty")
    normal, centre = (
        np.column_stack([table.pop(name) for name in names]) for names in (NORMAL, AXES)
    )
    length = np.hypot.reduce(normal, axis=1)
    _require(folder, table, np.abs(length - 1) <= UNIT, "its normal is not of length 1")
    outline, meets = list(table.pop("outline")), list(table.pop("meets"))
    alike = np.array(
        [len(a) == len(b) for a, b in zip(outline, meets, strict=True)], dtype=np.bool_
    )
    _require(folder, table, alike, "its fields outline and meets differ in length")
    planes = Plane3dTable(normal=normal, centre=centre, outline=outline, meets=meets, **table)
    return Plane3dResult(**vars(read_result(folder)), planes=planes)


def _require(folder: Path, table: dict[str, Any], holds: Bools, problem: str) -> None:
    wrong = np.flatnonzero((table["status"] == "static") & ~holds)
    if len(wrong):
        which = f"plane {table['plane'][wrong[0]]} is static, but {problem}"
        raise RelmapError(f"{folder / PLANES}: {which}")


def write_mesh(folder: Path, part: Submap | None, chosen: Ints) -> None:
    """Write planes of a submap, by number, as a coloured mesh: ``map.ply``.

    Raises `RelmapError` if the file cannot be written.
    """
    polygons, numbers = list[Floats](), list[int]()
    if part is not None:
        surfaces = surfaces_of(part.all_planes(), np.flatnonzero(np.isin(part.number, chosen)))
        for number in np.intersect1d(part.number, chosen).tolist():
            polygons += surfaces[int(np.flatnonzero(part.number == number)[0])].polygons()
            numbers += [number] * (len(polygons) - len(numbers))
    sizes = [len(polygon) for polygon in polygons]
    points = np.concatenate([np.empty((0, 3)), *polygons])
    shades = np.repeat(COLOURS[np.array(numbers, dtype=np.int64) % len(COLOURS)], sizes, axis=0)
    header = (
        "ply\nformat ascii 1.0\ncomment map frame, metres\n"
        f"element vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        f"element face {len(sizes)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vertices = [
        f"{x:.5f} {y:.5f} {z:.5f} {r} {g} {b}\n"
        for (x, y, z), (r, g, b) in zip(points.tolist(), shades.tolist(), strict=True)
    ]
    faces = [
        f"{size} {' '.join(str(k) for k in range(end - size, end))}\n"
        for size, end in zip(sizes, np.cumsum(sizes).tolist(), strict=True)
    ]
    atomic_write(folder / MAP_PLY, header + "".join(vertices) + "".join(faces))


def checked_patches(seen: Patches) -> Patches:
    """Return patches as a journal restores them: contiguous, 0 for -0; RelmapError if invalid."""
    arrays: dict[str, Any] = {
        name: np.ascontiguousarray(getattr(seen, name), dtype=np.float64) + 0.0 for name in ARRAYS
    }
    wrong = next((name for name, array in arrays.items() if not np.isfinite(array).all()), None)
    if wrong is not None:
        raise RelmapError(f"{wrong} of the patches has a number that is not finite")
    m, c = len(seen), len(seen.cell_patch)
    shapes = [(m, 3), (m, 3, 3), (m, 3), (m, 3), (c, 3), (len(seen.loose), 3)]
    for (name, array), shape in zip(arrays.items(), shapes, strict=True):
        if array.shape != shape:
            raise RelmapError(f"{name} of the patches has the shape {array.shape}, not {shape}")
    if not (arrays["information"][:, 2] > 0).all():
        raise RelmapError("information of the patches must be above 0 for the distance")
    whole = {name: getattr(seen, name).astype(np.int64) for name in ("n_points", "cell_patch")}
    if (np.diff(whole["cell_patch"], prepend=0, append=max(m - 1, 0)) < 0).any():
        raise RelmapError("cell_patch of the patches must ascend, and number them from 0 on")
    if m and not (0 < seen.cell_m < np.inf and 0 < seen.reach_m < np.inf):
        raise RelmapError("cell_m and reach_m of the patches must be above 0")
    return replace(seen, **arrays, **whole)


def journaled(seen: Patches) -> tuple[Floats, bytes]:
    """Return the columns (m, 19) of checked patches, and the rest."""
    m, about = len(seen), np.array([seen.cell_m, seen.reach_m, len(seen.cells)], dtype="<f8")
    columns = (seen.centre, seen.axes.reshape(m, 9), seen.information, seen.spread, seen.n_points)
    parts = (about, seen.cells, seen.cell_patch.astype("<i8"), seen.loose)
    return np.column_stack(columns), b"".join(part.tobytes() for part in parts)


def of_journal(values: Floats, cells: bytes) -> Patches:
    """Return the patches of a scan in a journal."""
    cell_m, reach_m, count = np.frombuffer(cells[:24], "<f8").tolist()
    c = int(count)
    centre, axes, information, spread, points = np.split(values, (3, 12, 15, 18), axis=1)
    at, of, loose = cells[24 : 24 + 24 * c], cells[24 + 24 * c : 24 + 32 * c], cells[24 + 32 * c :]
    return Patches(
        centre=centre.copy(),
        axes=axes.reshape(-1, 3, 3),
        information=information.copy(),
        spread=spread.copy(),
        n_points=points[:, 0].astype(np.int64),
        cells=np.frombuffer(at, "<f8").reshape(-1, 3),
        cell_patch=np.frombuffer(of, "<i8"),
        cell_m=cell_m,
        reach_m=reach_m,
        loose=np.frombuffer(loose, "<f8").reshape(-1, 3),
    )
