"""``relmap export``: a map in the format of another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from relmap.cli.arguments import refuse
from relmap.cli.console import busy

Target = Literal["grid", "dxf", "svg", "geojson", "g2o", "ply"]

HELP = """Write the map of a result in the format of another program.

RESULT is a folder written by 'relmap map', of points or of walls; if the run broke into submaps,
only the map is exported. OUT is a file, or a folder (a name without extension), in which the file
is called map.

\b
  grid     occupancy grid, a PGM picture and a YAML file, for the map servers of ROS; planar maps.
           Cells crossed by beams are free.  The beams are in RESULT/mapper.npz; without it give the
           log with --log, otherwise all but the walls is unknown
  dxf      AutoCAD R12: walls, corners or landmarks, and the path, each in a layer; metres
  svg      the map from above, in metres
  geojson  walls and corners, or landmarks, with the columns of the tables; in metres, not in
           longitude and latitude
  g2o      pose graph; for points with the landmarks, and with --log with the measurements
  ply      walls as edges and faces, or landmarks as points

\b
Examples:
  relmap export result --to grid -o map.yaml --resolution 0.05
  relmap export result --to dxf -o plan.dxf
"""


def command(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="The result folder.")],
    to: Annotated[Target, typer.Option("--to", help="The format.")],
    out: Annotated[
        str, typer.Option("--out", "-o", metavar="OUT", help="File or folder to write to.")
    ],
    log: Annotated[
        Path | None, typer.Option(metavar="LOG", help="For grid and g2o: the log that was mapped.")
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="For grid: the size of a cell; 0.05 if not given."),
    ] = None,
) -> None:
    """Export a map; the help text explains the arguments."""
    from relmap.exports.formats import RESOLUTION_M, export

    refuse(not out, "--out is empty, expected the name of a file or folder")
    refuse(resolution is not None and to != "grid", "--resolution is for --to grid")
    refuse(log is not None and to not in ("grid", "g2o"), "--log is for --to grid and g2o")
    cell_m = RESOLUTION_M if resolution is None else resolution
    with busy("exporting"):
        message = export(result, to, Path(out), log, cell_m)
    typer.echo(message)
