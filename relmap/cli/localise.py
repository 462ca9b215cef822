"""``relmap localise``: find where scans were taken in an existing map."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from relmap.cli import arguments as args
from relmap.cli.console import tracked

if TYPE_CHECKING:
    from relmap.evaluation.feeding import Log
    from relmap.mapper import Place
    from relmap.planes import PlaneMapper
    from relmap.points import PointMapper

HELP = """Find where scans were taken in an existing map.

INPUT is a log as for 'relmap map', RESULT a folder written by it, which is not changed. Each scan
is localised independently: the robot may have been carried anywhere between two scans. It writes
DIR/trajectory.tum, the pose of each localised scan in the frame of the map, and a picture,
DIR/map.png. A scan must show at least 7 mapped landmarks (5 in the plane), and half of what it
shows must be in the map. In a map of walls, half of the walls of a scan, and 3 m, must lie on
mapped walls, and 70 % of its beams must end there; or 30 % and half of the beams, if hardly any go
through walls. A scan of fewer than five walls needs 90 % of its beams. One that fits in more than
one place is refused, and counted. Clouds that show floors are levelled, as 'relmap map' does by
default.

\b
Example:
  relmap localise eight/observations.csv --map result -o where
"""

ALIKE = (
    "WARNING: more scans fit in several places than in one: many places of the map look alike, and "
    "a place outside the map that looks like one inside is taken for it"
)

NEEDED = {
    "points": "at least seven landmarks of the map (five in the plane), and little else",
    "planes": "walls of the map, not all parallel, and little else",
}
"""What a scan must show to be found."""


def command(
    source: args.Log,
    result: Annotated[
        Path, typer.Option("--map", metavar="RESULT", help="The result folder with the map.")
    ],
    out: args.Out,
    scans: args.Scans = None,
    log_format: args.Format = None,
    columns: args.Columns = None,
    topic: args.Topics = None,
) -> None:
    """Localise scans; the help text explains the arguments."""
    from relmap.cli.job import doubt_unit, level_if_needed, require_dimension
    from relmap.evaluation.sources import read_log
    from relmap.io.files import staged_folder
    from relmap.io.results import MAPPER, SUMMARY
    from relmap.mapper import Mapper
    from relmap.planes import PlaneMapper
    from relmap.points import PointMapper

    args.refuse_to_write_into(out, result)
    taken = f"--out is {out}, a result, whose path would be overwritten: give another folder"
    args.refuse((out / SUMMARY).exists(), taken)
    mapper = Mapper.load(result / MAPPER)
    assert isinstance(mapper, PointMapper | PlaneMapper)
    variant: Literal["points", "planes"] = "planes" if isinstance(mapper, PlaneMapper) else "points"
    of_table = columns and (variant == "planes" or log_format)
    args.refuse(of_table, "--columns applies only to tables of landmarks")
    log = read_log(source, variant, log_format, scans, columns, tuple(topic or ()))
    if isinstance(mapper, PlaneMapper):
        args.refuse(
            not (mapper.planes.status == "static").any(),
            f"{result}: the map has no wall, so no scan can be found in it, expected a map with "
            "walls",
        )
    require_dimension(source, log, mapper, result)
    doubt_unit(source, log)
    log = level_if_needed(source, log)
    with staged_folder(out) as staging:
        places = _places(mapper, log)
        _write(staging, mapper, log, places)
    _report(places, NEEDED[variant], out)


def _report(places: list[Place], needed: str, out: Path) -> None:
    """Print how many scans were found; `needed`: what a scan must show."""
    found, several = (sum(place.n_places == n for place in places) for n in (1, 2))
    message = f"found {found} of {len(places)} scans in the map"
    if several:
        message += f"; {several} fit in more than one place and were refused"
    elif not found:
        message += f": a scan must show {needed}"
    typer.echo(f"{message}; wrote 2 files to {out}")
    if 0 < found < several:
        typer.echo(ALIKE)


def _places(mapper: PointMapper | PlaneMapper, log: Log) -> list[Place]:
    from relmap.evaluation.feeding import preparation
    from relmap.planes import PlaneMapper

    prepare, walls = preparation(mapper, log), isinstance(mapper, PlaneMapper)
    scans: Iterable[Any] = tracked(log.scans(), len(log), "localising")
    seen = (scan.points_robot for scan in scans)
    return [mapper.locate(prepare(p), **({"beams": p} if walls else {})) for p in seen]


def _write(folder: Path, mapper: PointMapper | PlaneMapper, log: Log, places: list[Place]) -> None:
    """Write the poses that were found, and a picture of them in the map."""
    import numpy as np

    from relmap.evaluation.feeding import stamps_of
    from relmap.io.files import write_tum
    from relmap.io.results import MAP_PNG, TRAJECTORY
    from relmap.planes import PlaneMapper
    from relmap.plots.run import plot_localised
    from relmap.plots.sheet import write_png

    poses = np.array([place.T_map_robot for place in places]).reshape(-1, 4, 4)
    found = np.isfinite(poses[:, 0, 0])
    write_tum(folder / TRAJECTORY, stamps_of(log)[found], poses[found])
    planar, ends = mapper.engine.store.dimension == 2, None
    if isinstance(mapper, PlaneMapper):
        table = mapper.planes
        planar, ends = True, table.ends[table.status == "static"]
    drawn = np.flatnonzero(found), poses[found], len(log)
    write_png(folder / MAP_PNG, plot_localised, mapper.map, planar, *drawn, ends)
