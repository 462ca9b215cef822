"""``relmap map`` of points: from a log of landmarks to a result folder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from relmap.cli.arguments import parse_scans, read_config
from relmap.cli.job import Association, Job, journaled_labels
from relmap.cli.map_planes import BENCH_GIF, BENCH_PNG
from relmap.cli.outcome import each, leave, stopped_after, unconverged, untied
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.datasets.base import ObservationLog, Scan
    from relmap.evaluation.run import Run


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
        + unconverged(run.result.summary["refinement"])
    )
    if job.onto and job.association == "nearest" and run.result.summary["tied_at"] is None:
        typer.echo(f"no scan was found in the map of {job.onto}: the log is a piece of its own")
    leave(job, run.result.summary)


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
    from relmap.evaluation.run import run_mapper
    from relmap.io.files import staged_folder
    from relmap.io.results import MAP_PNG, MAPPER, write_result
    from relmap.plots.run import write_map_png
    from relmap.points.mapper import PointMapper

    source = job.at(job.source)
    log = _read(job, source)
    with (
        staged_folder(job.at(job.out), _stale(job.at(job.out))) as staging,
        ExitStack() as afterwards,
    ):

        def shown(scans: Iterable[Scan]) -> Iterator[Scan]:
            tied = job.onto is None or job.association == "known"
            for scan in job.scans(scans, len(log)):
                if not tied and mapper.take_up(scan.points_robot):
                    about["tied_at"], tied = scan.iteration, True
                yield scan
            about["configuration"] = mapper.settings
            afterwards.enter_context(busy("refining and writing"))

        seen = journaled_labels(job, log.scans())
        mapper = job.mapper(PointMapper)
        afterwards.callback(mapper.close)
        about = _about(job, job.log_format or recognised_format(source))
        before = mapper.n_iterations - len(seen)
        run = run_mapper(mapper, log, job.association, about, shown, job.refine, seen, before)
        write_result(staging, run.result)
        mapper.save(staging / MAPPER)
        write_map_png(staging / MAP_PNG, run.result, run.groups)
    return run


def _read(job: Job, source: Path) -> ObservationLog:
    from relmap.cli.console import busy
    from relmap.datasets import open_log

    with busy("reading"):
        log = open_log(source, job.log_format)
    if job.interval is not None:
        log = log.between(*job.interval)
    check_association(log, job.association, source)
    return log


def _stale(out: Path) -> list[str]:
    """Return the files of an earlier result, of walls too, that this one puts out of date."""
    from relmap.io.results import EVALUATION
    from relmap.planes.files import PLANES, submap_files

    return [EVALUATION, PLANES, BENCH_PNG, BENCH_GIF, *submap_files(out)]


def _about(job: Job, log_format: str | None) -> dict[str, Any]:
    return {
        "input": str(job.source),
        "format": log_format,
        "variant": "points",
        "seed": None,
        "configuration": {},
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
