"""``relmap localise``: find where scans were taken in a map that is there already."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from relmap.cli.console import Out, tracked

HELP = """Find where scans were taken, in a map that is there already and stays as it is.

INPUT is a log as for 'relmap map', RESULT a folder that it wrote.  Each scan is found by itself, so
the robot may have been carried anywhere between two scans.  It writes DIR/trajectory.tum, the pose
in the frame of the map of each scan that was found: it must show at least 7 mapped landmarks (5 in
the plane), and half of what it shows must be in the map.

\b
Example:
  relmap localise eight/observations.csv --map result -o where
"""


def localise_command(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="The log.")],
    result: Annotated[
        Path, typer.Option("--map", metavar="RESULT", help="The result folder with the map.")
    ],
    out: Out,
    scans: Annotated[
        str | None,
        typer.Option("--scans", metavar="A:B", help="Only iterations A to B - 1, counted from 0."),
    ] = None,
    log_format: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="Format of INPUT, as for 'relmap map'."),
    ] = None,
) -> None:
    """Localise scans; the arguments are explained in the help text."""
    import numpy as np

    from relmap.cli.arguments import parse_scans
    from relmap.datasets import open_log
    from relmap.evaluation.run import stamps_of
    from relmap.io.files import staged_folder, write_tum
    from relmap.io.results import MAPPER, TRAJECTORY
    from relmap.points import PointMapper

    interval = parse_scans(scans)
    mapper = PointMapper.load(result / MAPPER)
    log = open_log(source, log_format)
    if interval is not None:
        log = log.between(*interval)
    with staged_folder(out) as staging:
        each = tracked(log.scans(), len(log), "localising")
        poses = np.array([mapper.localise(scan.points_robot) for scan in each])
        found = np.isfinite(poses[:, 0, 0])
        write_tum(staging / TRAJECTORY, stamps_of(log)[found], poses[found])
    typer.echo(f"found {found.sum()} of {len(log)} scans in the map; wrote 1 file to {out}")
