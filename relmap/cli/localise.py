"""``relmap localise``: find where scans were taken in an existing map."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from relmap.cli.arguments import Format, Log, Out, Scans
from relmap.cli.console import tracked

HELP = """Find where scans were taken in an existing map.

INPUT is a log as for 'relmap map', RESULT a folder written by it, which is not changed. Each scan
is localised independently: the robot may have been carried anywhere between two scans. It writes
DIR/trajectory.tum, the pose of each localised scan in the frame of the map, and a picture,
DIR/map.png. A scan must show at least 7 mapped landmarks (5 in the plane), and half of what it
shows must be in the map.

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

    from relmap.evaluation.run import stamps_of
    from relmap.evaluation.sources import read_log
    from relmap.io.files import staged_folder, write_tum
    from relmap.io.results import MAP_PNG, MAPPER, TRAJECTORY
    from relmap.plots.localised import write_localised_png
    from relmap.points import PointMapper

    mapper = PointMapper.load(result / MAPPER)
    log = read_log(source, "points", log_format, scans)
    each: Iterable[Any] = tracked(log.scans(), len(log), "localising")
    with staged_folder(out) as staging:
        poses = np.array([mapper.localise(scan.points_robot) for scan in each])
        found = np.isfinite(poses[:, 0, 0])
        write_tum(staging / TRAJECTORY, stamps_of(log)[found], poses[found])
        planar = mapper.engine.store.dimension == 2
        drawn = np.flatnonzero(found), poses[found], len(log)
        write_localised_png(staging / MAP_PNG, mapper.map, planar, *drawn)
    typer.echo(f"found {found.sum()} of {len(log)} scans in the map; wrote 2 files to {out}")
