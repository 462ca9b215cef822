"""``relmap map``: make a map from a log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from relmap.cli.console import Out
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.core.config import MapperConfig
    from relmap.datasets.base import ObservationLog, Scan
    from relmap.evaluation.run import Run

Association = Literal["nearest", "known"]
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

It writes DIR/landmarks.csv, tracks.csv.gz, trajectory.tum, map.ply, map.png, pieces.csv and
summary.json, and of walls also planes.csv.

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
) -> None:
    """Map a log; the arguments are explained in the help text."""
    if variant == "planes":
        _map_planes(source, out, association, scans, log_format, config, registration, refine)
        return
    run = map_input(source, out, association, scans, log_format, config, registration, refine)
    counts, timing = run.result.summary["counts"], run.result.summary["timing"]
    apart = len(run.result.pieces) - 1
    typer.echo(
        f"wrote 7 files to {out}: {counts['mapped']} of {counts['landmarks']} landmarks mapped "
        f"from {counts['observations']} observations in {counts['iterations']} iterations, "
        f"median {timing['median_ms']:.2g} ms each" + _untied(apart)
    )


def _untied(pieces: int) -> str:
    if pieces < 1:
        return ""
    return f"; {pieces} piece{'s' if pieces > 1 else ''} could not be tied to the map"


def _map_planes(
    source: Path,
    out: Path,
    association: Association,
    scans: str | None,
    log_format: str | None,
    config: Path | None,
    registration: Registration | None,
    refine: bool,
) -> None:
    """Map walls, and tell what came out."""
    from relmap.cli.map_planes import map_scans

    if association == "known" or registration is not None:
        raise RelmapError("walls have no ids: --association and --registration are for points")
    run = map_scans(source, out, read_config(config), parse_scans(scans), log_format, refine)
    counts, timing = run.result.summary["counts"], run.result.summary["timing"]
    apart = len(run.result.summary["pieces"]) - 1
    typer.echo(
        f"wrote 8 files to {out}: {counts['planes_static']} walls with "
        f"{counts['corners_static']} corners mapped in {counts['iterations']} iterations, "
        f"median {timing['median_ms']:.2g} ms each beside segmentation" + _untied(apart)
    )


def map_input(
    source: Path,
    out: Path,
    association: Association = "nearest",
    scans: str | None = None,
    log_format: str | None = None,
    config: Path | None = None,
    registration: Registration | None = None,
    refine: bool = True,
) -> Run:
    """Map a log into a result folder.

    Raises
    ------
    RelmapError
        Where an argument or the log cannot be used, or the folder cannot be written; an earlier
        result in it is then as it was.
    """
    from relmap.cli.console import busy, tracked
    from relmap.datasets import open_log
    from relmap.evaluation.run import run_mapper
    from relmap.files import staged_folder
    from relmap.plots.run import write_map_png
    from relmap.points.mapper import PointMapper
    from relmap.results import EVALUATION, MAP_PNG, write_result

    interval = parse_scans(scans)
    settings = read_config(config)
    if registration is not None:
        settings = replace(settings, registration=registration)
    with busy("reading"):
        log = open_log(source, log_format)
    if interval is not None:
        log = log.between(*interval)
    check_association(log, association, source)
    with staged_folder(out, stale=[EVALUATION]) as staging, ExitStack() as afterwards:

        def shown(scans: Iterable[Scan]) -> Iterator[Scan]:
            yield from tracked(scans, len(log), "mapping")
            afterwards.enter_context(busy("refining and writing"))

        about = _about(source, log_format or recognised_format(source), settings)
        run = run_mapper(
            PointMapper(settings),
            log,
            association,
            about,
            shown,
            refine=refine,
        )
        write_result(staging, run.result)
        write_map_png(staging / MAP_PNG, run.result, run.groups)
    return run


def _about(source: Path, log_format: str | None, settings: MapperConfig) -> dict[str, Any]:
    return {
        "input": str(source),
        "format": log_format,
        "variant": "points",
        "seed": None,
        "configuration": asdict(settings),
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
