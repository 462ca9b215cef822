"""``relmap map``: make a map from a log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from relmap.cli.console import INTERRUPTED, Out
from relmap.cli.interrupt import stoppable
from relmap.cli.job import Association, Job, journaled_labels
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.core.config import MapperConfig
    from relmap.datasets.base import ObservationLog, Scan
    from relmap.evaluation.run import Run

Variant = Literal["points", "planes"]
Registration = Literal["constellation", "nearest-previous"]

_LONGEST = 300
"""Characters that a message takes from a file of settings."""

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

It writes DIR/landmarks.csv, tracks.csv.gz, trajectory.tum, map.ply, map.png, pieces.csv,
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
    if planes and (association == "known" or registration is not None):
        raise RelmapError("walls have no ids: --association and --registration are for points")
    if animate and not planes:
        raise RelmapError("--animate draws walls: give --variant planes with it")
    with stoppable() as stopped:
        job = Job(
            source=source,
            out=out,
            settings=_settings(config, registration),
            association=association,
            interval=parse_scans(scans),
            log_format=log_format,
            refine=refine,
            journal=journal,
            onto=onto,
            animate=animate,
            stopped=stopped,
        )
        if planes:
            from relmap.cli.map_planes import report_planes

            report_planes(job)
        else:
            report_points(job)


def report_points(job: Job) -> None:
    """Map points, and tell what came out.

    Raises
    ------
    typer.Exit
        Where the run was interrupted.
    """
    run = map_points(job)
    counts, timing = run.result.summary["counts"], run.result.summary["timing"]
    typer.echo(
        f"{stopped_after(run.result.summary)}wrote 8 files to {job.out}: {counts['mapped']} of "
        f"{counts['landmarks']} landmarks mapped from {counts['observations']} observations in "
        f"{counts['iterations']} iterations, {each(timing['median_ms'])}"
        + untied(len(run.result.pieces) - 1)
    )
    if job.onto and job.association == "nearest" and run.result.summary["tied_at"] is None:
        typer.echo(f"no scan was found in the map of {job.onto}: the log is a piece of its own")
    leave(job, run.result.summary)


def stopped_after(summary: dict[str, Any]) -> str:
    """Return how far an interrupted run came, as the beginning of a message."""
    if not summary["interrupted"]:
        return ""
    return f"stopped after {summary['counts']['iterations']} of {summary['input_iterations']}: "


def each(median_ms: float | None) -> str:
    """Return how long an iteration took, as part of a message."""
    return "none of them new" if median_ms is None else f"median {median_ms:.2g} ms each"


def untied(pieces: int) -> str:
    """Return how many pieces of a map are apart, as the end of a message."""
    if pieces < 1:
        return ""
    return f"; {pieces} piece{'s' if pieces > 1 else ''} could not be tied to the map"


def leave(job: Job, summary: dict[str, Any]) -> None:
    """End the program as what became of the run demands.

    Raises
    ------
    typer.Exit
        Where the run was interrupted.
    """
    if summary["interrupted"]:
        if job.journal is not None:
            typer.echo(f"'relmap resume {job.journal}' goes on with it")
        raise typer.Exit(INTERRUPTED)


def map_input(
    source: Path, out: Path, association: Association = "nearest", scans: str | None = None
) -> Run:
    """Map a log of points into a result folder, as `relmap map` does.

    Raises
    ------
    RelmapError
        As `map_points` does.
    """
    settings = read_config(None)
    interval = parse_scans(scans)
    return map_points(
        Job(source=source, out=out, settings=settings, association=association, interval=interval)
    )


def map_points(job: Job) -> Run:
    """Map a log of points into a result folder.

    Raises
    ------
    RelmapError
        Where an argument or the log cannot be used, or the folder cannot be written; an earlier
        result in it is then as it was.
    """
    from relmap.cli.console import busy
    from relmap.datasets import open_log
    from relmap.evaluation.run import run_mapper
    from relmap.files import staged_folder
    from relmap.plots.run import write_map_png
    from relmap.points.mapper import PointMapper
    from relmap.results import EVALUATION, MAP_PNG, MAPPER, write_result

    source = job.at(job.source)
    with busy("reading"):
        log = open_log(source, job.log_format)
    if job.interval is not None:
        log = log.between(*job.interval)
    check_association(log, job.association, source)
    with staged_folder(job.at(job.out), stale=[EVALUATION]) as staging, ExitStack() as afterwards:

        def shown(scans: Iterable[Scan]) -> Iterator[Scan]:
            tied = job.onto is None or job.association == "known"
            for scan in job.scans(scans, len(log)):
                if not tied and mapper.take_up(scan.points_robot):
                    about["tied_at"], tied = scan.iteration, True
                yield scan
            afterwards.enter_context(busy("refining and writing"))

        seen = journaled_labels(job, log.scans())
        mapper = job.mapper(PointMapper)
        afterwards.callback(mapper.close)
        about = _about(job, job.log_format or recognised_format(source), mapper.config)
        before = mapper.n_iterations - len(seen)
        run = run_mapper(mapper, log, job.association, about, shown, job.refine, seen, before)
        write_result(staging, run.result)
        mapper.save(staging / MAPPER)
        write_map_png(staging / MAP_PNG, run.result, run.groups)
    return run


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


def _settings(config: Path | None, registration: Registration | None) -> MapperConfig:
    settings = read_config(config)
    return settings if registration is None else replace(settings, registration=registration)


def _about(job: Job, log_format: str | None, settings: MapperConfig) -> dict[str, Any]:
    return {
        "input": str(job.source),
        "format": log_format,
        "variant": "points",
        "seed": None,
        "configuration": asdict(settings),
        "onto": None if job.onto is None else str(job.onto),
        "tied_at": None,
    }


def recognised_format(source: Path) -> str | None:
    """Return the name of the format that a log is recognised as; None where it is not."""
    from relmap.datasets import DATASETS

    names = [dataset.name for dataset in DATASETS if dataset.recognises(source)]
    return names[0] if len(names) == 1 else None


def check_association(log: ObservationLog, association: Association, source: Path) -> None:
    """Make sure that a log has the ids that a known association needs.

    Raises
    ------
    RelmapError
        Where it has none.
    """
    if association == "known" and (log.ids is None or not (log.ids >= 0).any()):
        raise RelmapError(
            f"--association known needs the identity of each landmark, and {source} has no ids"
        )


def parse_scans(text: str | None) -> tuple[int, int] | None:
    """Return the interval that ``A:B`` names.

    Raises
    ------
    RelmapError
        Where it is not two whole numbers with 0 <= A < B.
    """
    if text is None:
        return None
    begin, colon, end = text.partition(":")
    if colon and begin.isascii() and begin.isdigit() and end.isascii() and end.isdigit():
        interval = int(begin), int(end)
        if interval[0] < interval[1]:
            return interval
    raise RelmapError(f"--scans is {text!r}: it must be A:B, whole numbers with 0 <= A < B")


def read_config(path: Path | None) -> MapperConfig:
    """Read a mapper's configuration from a TOML file; the default one where there is none.

    Raises
    ------
    RelmapError
        Where the file cannot be read, is not TOML or holds what a configuration does not know.
    """
    import tomllib

    from relmap.core.config import MapperConfig
    from relmap.files import read_text

    if path is None:
        return MapperConfig()
    try:
        return MapperConfig.from_mapping(tomllib.loads(read_text(path)))
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, nested deep
        raise RelmapError(f"{path}: not TOML: {str(error)[:_LONGEST]}") from error
    except RelmapError as error:
        problem = str(error)
        if str(path) not in problem:
            problem = f"{path}: {problem[:_LONGEST]}"
        raise RelmapError(problem) from error
