"""``relmap map``: make a map from a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from relmap.cli.arguments import parse_scans, read_config
from relmap.cli.console import Out
from relmap.cli.interrupt import stoppable
from relmap.cli.job import Association, Job, Variant
from relmap.cli.outcome import report
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.core.config import MapperConfig

Registration = Literal["constellation", "nearest-previous"]

HELP = """Make a map from a log of landmarks that a moving robot saw.

INPUT is a file or folder.  The simplest is a CSV file with the header iteration,x,y,z or
iteration,x,y (a planar world) and one row per landmark seen: its place in the robot's frame
(x ahead, y left, z up, metres).  A column id may tell which landmark it is.

\b
Formats of INPUT:
  observation-csv  the CSV file just described, or a folder with observations.csv
  mrpt-landmarks   range and bearing to landmarks, from a log of MRPT
  victoria-park    trees per scan, from the Victoria Park data set
  dlr-circles      circles on a floor, map.circles of the DLR spatial cognition data set
  slsjf-sim        range and bearing to beacons, the folder of I-SLSJF's simulation

\b
With --variant planes INPUT is a log of point scans, and walls are mapped:
  scans-npz        scans.npz as 'relmap simulate building' writes it, or its folder
  carmen-log       2-D laser scans of CARMEN, .log or .log.gz
  mrpt-laser2d     2-D laser scans of MRPT's simulation, *.scans.csv.gz
  point-clouds     a folder of .pcd or .ply files, one for each scan

It writes DIR/landmarks.csv, tracks.csv.gz, trajectory.tum, map.ply, map.png, submaps.csv,
summary.json and mapper.npz, the state to go on from, and of walls also planes.csv and bench.png:
the last scan, its planes, the map and its groups; with --animate the whole run like that in
bench.gif.  Ctrl-C ends the mapping early and writes what was mapped so far; pressed again it ends
at once.

\b
Examples:
  relmap map eight/observations.csv -o result
  relmap map eight/observations.csv -o result --association known --scans 0:300
  relmap map building/scans.npz -o result --variant planes
"""


def map_command(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="The log.")],
    out: Out,
    variant: Annotated[
        Variant, typer.Option(help="What the landmarks are: points, or walls in point scans.")
    ] = "points",
    association: Annotated[
        Association,
        typer.Option(help="Find out which landmark is which, or take the log's ids."),
    ] = "nearest",
    refine: Annotated[
        bool,
        typer.Option(
            "--refine/--no-refine",
            help="At the end, bring all landmarks to where all observations agree best.",
        ),
    ] = True,
    scans: Annotated[
        str | None,
        typer.Option(
            "--scans", metavar="A:B", help="Map only iterations A to B - 1, counted from 0."
        ),
    ] = None,
    log_format: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="NAME",
            help="Format of INPUT, from the list above; recognised where left out.",
        ),
    ] = None,
    registration: Annotated[
        Registration | None,
        typer.Option(
            help="How observations without ids are matched: by constellations that agree, or "
            "the paper's way, to the nearest of the previous iteration."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            metavar="FILE.toml",
            help="Settings of the mapper: the fields of relmap.MapperConfig, as field = value.",
        ),
    ] = None,
    journal: Annotated[
        Path | None,
        typer.Option(
            "--journal",
            metavar="FILE",
            help="Keep what is read and found in this SQLite file, so that 'relmap resume FILE' "
            "can go on if the run is ended before its time.",
        ),
    ] = None,
    onto: Annotated[
        Path | None,
        typer.Option(
            "--onto",
            metavar="RESULT",
            help="Add the log to the map in this result folder: where a scan is found in it, the "
            "mapping goes on from there.",
        ),
    ] = None,
    animate: Annotated[
        bool,
        typer.Option("--animate", help="Of walls, draw the whole run as an animation, bench.gif."),
    ] = False,
) -> None:
    """Map a log; the arguments are explained in the help text."""
    planes = variant == "planes"
    _check_onto(onto, planes, journal, config, registration)
    _check_matching(planes, association, registration)
    if animate and not planes:
        raise RelmapError("--animate draws walls: give --variant planes with it")
    with stoppable() as stopped:
        job = Job(
            source=source,
            out=out,
            variant=variant,
            settings=_settings(config, registration, planes, association),
            association=association,
            interval=parse_scans(scans),
            log_format=log_format,
            refine=refine,
            journal=journal,
            onto=onto,
            animate=animate,
            stopped=stopped,
        )
        report(job)


def _check_onto(
    onto: Path | None,
    planes: bool,
    journal: Path | None,
    config: Path | None,
    registration: Registration | None,
) -> None:
    """Make sure that a map that is to be added to needs nothing else."""
    if onto is None:
        return
    if planes:
        raise RelmapError("--onto adds to a map of points; walls are mapped in one go")
    if journal is not None:
        raise RelmapError("--journal keeps a run from its beginning, which --onto has not got")
    if config is not None or registration is not None:
        raise RelmapError("--onto goes on with the settings of the earlier run: give no others")


def _check_matching(
    planes: bool, association: Association, registration: Registration | None
) -> None:
    """Make sure that nothing is said of matching where there is none of that kind."""
    if planes and (association == "known" or registration is not None):
        raise RelmapError("walls have no ids: --association and --registration are for points")
    if association == "known" and registration is not None:
        raise RelmapError("--registration is for observations without ids: leave out --association")


def _settings(
    config: Path | None, registration: Registration | None, planes: bool, association: Association
) -> MapperConfig:
    from relmap.core.config import WITH_IDS, WITH_WALLS

    unused = WITH_WALLS if planes else WITH_IDS if association == "known" else {}
    return read_config(config, registration, unused)
