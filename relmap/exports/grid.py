"""An occupancy grid for ROS's map servers: a PGM picture and a YAML file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.exports.content import MapContent
from relmap.exports.sight import Lines

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
"""Pixels of the trinary mode."""
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""Unknown is (255 - 205) / 255 = 0.19608, which must not be below the second."""
STOPPED = 0.25
"""Fraction of the beams reaching a cell that must end there for it to be occupied."""
BULK = (0.0005, 0.9995)
"""The grid covers at least the range between these quantiles of the beam ends."""
RIM = 5
"""Margin, in cells, around the known area."""
MOST_CELLS = 100_000_000
NEAREST_M, FARTHEST_M = 1e-3, 100.0
"""Minimum and maximum size of a cell."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A grid seen from above.

    `pixels` (rows, columns): `OCCUPIED`, `FREE` or `UNKNOWN`; the first row has the least y, the
    first column the least x. `origin_m` (2,), map frame: the lower left corner of the first cell.
    `resolution_m`: size of a cell.
    """

    pixels: NDArray[np.uint8]
    origin_m: Floats
    resolution_m: float


def grid_of(content: MapContent, lines: Lines | None, resolution_m: float) -> Grid:
    """Return the grid of a planar map.

    Occupied are the cells of mapped walls or landmarks, and those in which at least a quarter of
    the beams that reached them ended; all other cells crossed by a beam are free.

    `lines`: see `relmap.exports.sight.sight_lines`. Raises `RelmapError` if the map is in space or
    empty, or the grid would be too large.
    """
    from relmap.exports.grid_kernels import cast

    if not NEAREST_M <= resolution_m <= FARTHEST_M:
        raise RelmapError(
            f"--resolution is {resolution_m!r}; it must be {NEAREST_M:g} to {FARTHEST_M:g} metres"
        )
    if not content.result.planar:
        raise RelmapError("a grid is planar and this map is of points in space: export it to ply")
    begins, ends = (np.empty((0, 2)),) * 2 if lines is None else lines
    origin, shape = _frame(content, ends, resolution_m)
    passed, ended, solid = np.zeros((3, *shape), dtype=np.int64)
    cast((begins - origin) / resolution_m, (ends - origin) / resolution_m, passed, ended)
    if content.walls is not None:
        there = content.walls.ends
    else:  # lines of length 0
        there = np.repeat(content.landmarks.position[:, None, :2], 2, axis=1)
    cast((there[:, 0] - origin) / resolution_m, (there[:, 1] - origin) / resolution_m, solid, solid)
    reached = passed + ended
    pixels = np.where(reached > 0, FREE, UNKNOWN)
    pixels[(solid > 0) | ((ended > 0) & (ended >= STOPPED * reached))] = OCCUPIED
    return Grid(pixels.astype(np.uint8), origin, resolution_m)


def _frame(
    content: MapContent, ends: Floats, resolution_m: float
) -> tuple[Floats, tuple[int, int]]:
    """Return the lower left corner of the grid, and how many rows and columns it has."""
    places = content.places[:, :2]
    if len(ends):
        places = np.concatenate([places, np.quantile(ends, BULK, axis=0)])
    if not len(places):
        raise RelmapError("the map is empty: no grid can be made")
    first = np.floor(places.min(axis=0) / resolution_m) - RIM
    columns, rows = np.floor(places.max(axis=0) / resolution_m) + RIM + 1 - first
    if not rows * columns <= MOST_CELLS:
        raise RelmapError(
            f"a grid of {columns:.0f} x {rows:.0f} cells is too large, expected at most "
            f"{MOST_CELLS}: give a coarser --resolution than {resolution_m:g} m"
        )
    return first * resolution_m, (int(rows), int(columns))


def pgm_bytes(grid: Grid) -> bytes:
    """Return the picture, a binary PGM: its first row is the last of the grid."""
    rows, columns = grid.pixels.shape
    return f"P5\n{columns} {rows}\n255\n".encode() + grid.pixels[::-1].tobytes()


def yaml_text(picture: str, grid: Grid) -> str:
    """Return the YAML description of a picture with a given name.

    Numbers have no exponent: some YAML readers treat 1e-05 as text.
    """
    resolution, x, y = (
        np.format_float_positional(number, precision=12, trim="0")
        for number in (grid.resolution_m, *grid.origin_m)
    )
    name = picture.replace("'", "''")
    return (
        f"image: '{name}'\n"
        "mode: trinary\n"
        f"resolution: {resolution}\n"
        f"origin: [{x}, {y}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\n"
        f"free_thresh: {FREE_THRESH}\n"
    )
