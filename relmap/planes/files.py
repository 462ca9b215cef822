"""``planes.csv``: the walls of a result folder, written and read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relmap.io.files import atomic_write, write_tum
from relmap.io.results import Result, read_result
from relmap.io.tables import Kind, csv_text, read_table
from relmap.planes.table import PlaneTable

PLANES = "planes.csv"
CORNER, OPEN = "corner", "open"

COLUMNS: dict[str, Kind] = {
    "plane": "int",
    "x0": "float or empty",
    "y0": "float or empty",
    "x1": "float or empty",
    "y1": "float or empty",
    "z0": "float or empty",
    "z1": "float or empty",
    "nx": "float or empty",
    "ny": "float or empty",
    "nz": "float or empty",
    "end0": "text",
    "end1": "text",
    "observations": "int",
    "first_iteration": "int",
    "last_iteration": "int",
    "status": "text",
    "corner0": "int",
    "corner1": "int",
}


@dataclass(frozen=True, eq=False)
class DrawnSubmap:
    """A submap as files and pictures show it.

    Attributes
    ----------
    iterations : (k,) int64
        The log's own numbers.
    stamps_s : (k,) float64
    poses : (k, 4, 4) float64
        ``T_submap_robot``.
    planes : PlaneTable
        Mapped in its frame.
    points : (n, 2) float64, frame of the submap, metres
        Where some of the beams ended.
    point_scan : (n,) int64, ascending
        Place in `poses` of the scan that each of them is of.
    weak : (w,) int64
        Places in `poses` of the scans before which too little was seen to tell how far the robot
        went.
    """

    iterations: NDArray[np.int64]
    stamps_s: NDArray[np.float64]
    poses: NDArray[np.float64]
    planes: PlaneTable
    points: NDArray[np.float64]
    point_scan: NDArray[np.int64]
    weak: NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaneResult(Result):
    """A result whose landmarks are the corners of walls.

    Its tracks tell the wall of every one seen: `row` counts the walls of a scan, `landmark` is the
    number of the wall.

    Attributes
    ----------
    planes : PlaneTable
        Iterations are the log's own numbers.
    drawn : tuple of DrawnSubmap
        Parts of the run that nothing ties to one another, the map itself first; empty in a result
        that was read.
    """

    planes: PlaneTable
    drawn: tuple[DrawnSubmap, ...] = ()

    @property
    def planar(self) -> bool:
        """Whether the world is planar; walls are always mapped in the plane."""
        return True


def write_planes(folder: Path, table: PlaneTable) -> None:
    """Write ``planes.csv`` into an existing folder.

    Raises
    ------
    RelmapError
        Where the file cannot be written.
    """
    n = len(table.plane)
    kind = np.where(table.corner >= 0, CORNER, OPEN)
    columns = [
        table.plane.tolist(),
        *table.ends.reshape(n, 4).T.tolist(),
        *table.z_extent.T.tolist(),
        *np.column_stack([table.normal, np.zeros(n)]).T.tolist(),
        *kind.T.tolist(),
        table.observations.tolist(),
        table.first_iteration.tolist(),
        table.last_iteration.tolist(),
        table.status.tolist(),
        *table.corner.T.tolist(),
    ]
    text = csv_text(list(COLUMNS), zip(*columns, strict=True))
    atomic_write(folder / PLANES, text)


def write_submaps(
    folder: Path, submaps: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]
) -> None:
    """Write the times (k,) and poses (k, 4, 4) of all submaps but the first: ``submap-K.tum``.

    Raises
    ------
    RelmapError
        Where a file cannot be written.
    """
    for number, (stamps_s, poses) in enumerate(submaps[1:], start=1):
        write_tum(folder / f"submap-{number}.tum", stamps_s, poses)


def submap_files(folder: Path) -> list[str]:
    """Return the names of the files of submaps that are in a folder."""
    try:
        return sorted(path.name for path in folder.glob("submap-*.tum"))
    except OSError:  # no folder can have this name: writing there reports it
        return []


def read_planes(folder: Path) -> PlaneTable:
    """Read ``planes.csv`` of a result folder.

    Raises
    ------
    RelmapError
        Where it is missing or not what `write_planes` writes.
    """
    table = read_table(folder / PLANES, COLUMNS)
    ends = np.column_stack([table[name] for name in ("x0", "y0", "x1", "y1")])
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


def read_any(folder: Path) -> Result:
    """Read a result folder; of walls a `PlaneResult`.

    Raises
    ------
    RelmapError
        Where a file is missing or not what was written.
    """
    result = read_result(folder)
    # Planes in space stand in a file of that name, too.
    if not (folder / PLANES).exists() or result.summary.get("variant") == "planes3d":
        return result
    return PlaneResult(**vars(result), planes=read_planes(folder))
