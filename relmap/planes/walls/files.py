"""Reading and writing ``planes.csv``, the walls of a result folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.core.errors import RelmapError
from relmap.core.shown import NORMAL
from relmap.io.files import atomic_write, write_tum
from relmap.io.results import PLANES, Result, read_result
from relmap.io.tables import Kind, columns_text, read_columns
from relmap.planes.walls.table import PlaneTable

CORNER, OPEN = "corner", "open"
ENDS = "x0", "y0", "x1", "y1"

COLUMNS: dict[str, Kind] = {
    "plane": "int",
    **dict.fromkeys((*ENDS, "z0", "z1", *NORMAL), "float or empty"),
    **dict.fromkeys(("end0", "end1"), "text"),
    **dict.fromkeys(("observations", "first_iteration", "last_iteration"), "int"),
    "status": "text",
    **dict.fromkeys(("corner0", "corner1"), "int"),
}


@dataclass(frozen=True, eq=False)
class DrawnSubmap:
    """A submap for files and pictures.

    `iterations` (k,): iteration numbers of the log; `stamps_s` (k,): NaN of scans of earlier logs;
    `poses` (k, 4, 4): ``T_submap_robot``; `planes`: walls in its frame; `points` (n, 2), frame of
    the submap, metres: end points of some of the beams; `point_scan` (n,), ascending: index in
    `poses` of the scan of each point; `weak` (w,): indices in `poses` of the scans whose motion
    since the previous one is not fully determined.
    """

    iterations: Ints
    stamps_s: Floats
    poses: Floats
    planes: PlaneTable
    points: Floats
    point_scan: Ints
    weak: Ints


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PlaneResult(Result):
    """A result whose landmarks are the corners of walls.

    In its tracks, `row` is the index of a wall in its scan and `landmark` the number of the wall.

    Attributes
    ----------
    planes : PlaneTable
        With the iteration numbers of the log.
    drawn : tuple of DrawnSubmap
        The submaps, the map itself first; empty for a result read from files.
    """

    planes: PlaneTable
    drawn: tuple[DrawnSubmap, ...] = ()

    @property
    def planar(self) -> bool:
        """Whether the world is planar; walls are always mapped in the plane."""
        return True


def write_planes(folder: Path, table: PlaneTable, name: str = PLANES) -> None:
    """Write walls as ``planes.csv``, or a file of another name, into an existing folder.

    Raises `RelmapError` if the file cannot be written.
    """
    ends = dict(zip(("end0", "end1"), np.where(table.corner >= 0, CORNER, OPEN).T, strict=True))
    columns = table.columns() | ends | {"nz": np.zeros(len(table))}
    atomic_write(folder / name, columns_text({column: columns[column] for column in COLUMNS}))


def write_submaps(folder: Path, submaps: Sequence[DrawnSubmap]) -> None:
    """Write walls and path of all submaps except the first: ``submap-K.csv``, ``submap-K.tum``.

    Scans of earlier logs, whose times are NaN, are left out of the path.

    Raises `RelmapError` if a file cannot be written.
    """
    for number, submap in enumerate(submaps[1:], start=1):
        write_planes(folder, submap.planes, f"submap-{number}.csv")
        own = np.isfinite(submap.stamps_s)
        if own.any():
            write_tum(folder / f"submap-{number}.tum", submap.stamps_s[own], submap.poses[own])


def read_planes(folder: Path) -> PlaneTable:
    """Read ``planes.csv`` of a result folder.

    Raises `RelmapError` if it is missing or was not written by `write_planes`.
    """
    table = read_columns(folder / PLANES, COLUMNS)
    for name in (*ENDS, "nx", "ny"):
        empty = np.flatnonzero((table["status"] == "static") & np.isnan(table[name]))
        if len(empty):
            which = f"wall {table['plane'][empty[0]]} is static, but its field {name} is empty"
            raise RelmapError(f"{folder / PLANES}: {which}")
    ends = np.column_stack([table[name] for name in ENDS])
    return PlaneTable(
        plane=table["plane"],
        ends=ends.reshape(-1, 2, 2),
        z_extent=np.column_stack([table["z0"], table["z1"]]),
        normal=np.column_stack([table["nx"], table["ny"]]),
        corner=np.column_stack([table["corner0"], table["corner1"]]),
        observations=table["observations"],
        first_iteration=table["first_iteration"],
        last_iteration=table["last_iteration"],
        status=table["status"],
    )


def read_any(folder: Path, not_in_space: str = "") -> Result:
    """Read a result folder; for walls a `PlaneResult`.

    Raises `RelmapError` if a file is missing or invalid, or the map is of planes in space, with
    what is done to others only, if that is given.
    """
    result = read_result(folder)
    in_space = result.summary.get("variant") == "planes3d"
    if in_space and not_in_space:
        raise RelmapError(
            f"{folder} is a map of planes in space: only points and walls (variants points and "
            f"planes) are {not_in_space}"
        )
    # Planes in space use a file of the same name.
    if in_space or not (folder / PLANES).exists():
        return result
    return PlaneResult(**vars(result), planes=read_planes(folder))
