"""``relmap localise``: find where scans were taken in an existing map."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from relmap.cli.arguments import Format, Log, Out, Scans
from relmap.cli.console import tracked

HELP = """Find where scans were taken in an existing map.

INPUT is a log as for 'relmap map', RESULT a folder that it wrote, which is not changed.  Each scan
is found on its own: the robot may have been carried anywhere between two scans.  It writes
DIR/trajectory.tum, the pose of each scan that was found, in the frame of the map, and a picture,
DIR/map.png.  A scan must show at least 7 mapped landmarks (5 in the plane), and half of what it
shows must be in the map.  In a map of walls half of the walls of a scan, and 3 m, must lie on
mapped walls, and 70 % of its beams must end there.  A scan that fits in more than one place is
left out, and counted.

\b
Example:
  relmap localise eight/observations.csv --map result -o where
"""


def localise_command(
    source: Log,
    result: Annotated[
        Path, typer.Option("--map", metavar="RESULT", help="The result folder with the map.")
    ],
    out: Out,
    scans: Scans = None,
    log_format: Format = None,
) -> None:
    """Localise scans; the help text explains the arguments."""
    import numpy as np

    from relmap.evaluation.feeding import preparation
    from relmap.evaluation.run import stamps_of
    from relmap.evaluation.sources import read_log
    from relmap.io.files import staged_folder, write_tum
    from relmap.io.results import MAP_PNG, MAPPER, TRAJECTORY
    from relmap.mapper import Mapper
    from relmap.planes import PlaneMapper
    from relmap.plots.localised import write_localised_png
    from relmap.points import PointMapper

    mapper = Mapper.load(result / MAPPER)
    assert isinstance(mapper, PointMapper | PlaneMapper)
    walls = isinstance(mapper, PlaneMapper)
    log = read_log(source, "planes" if walls else "points", log_format, scans)
    prepare = preparation(mapper, log)
    each: Iterable[Any] = tracked(log.scans(), len(log), "localising")
    with staged_folder(out) as staging:
        places = []
        for scan in each:
            seen, beams = prepare(scan.points_robot), {"beams": scan.points_robot} if walls else {}
            places.append(mapper.locate(seen, **beams))
        poses = np.array([place.T_map_robot for place in places])
        found = np.isfinite(poses[:, 0, 0])
        write_tum(staging / TRAJECTORY, stamps_of(log)[found], poses[found])
        drawn = np.flatnonzero(found), poses[found], len(log)
        write_localised_png(staging / MAP_PNG, mapper, *drawn)
    told = f"found {found.sum()} of {len(log)} scans in the map"
    if several := sum(place.n_places > 1 for place in places):
        told += f"; {several} fit in more than one place and were left out"
    typer.echo(f"{told}; wrote 2 files to {out}")
