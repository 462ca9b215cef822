"""``relmap map --variant planes``: make a map of walls from a log of point scans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from relmap.cli.job import Job, journaled_labels
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.datasets.scans import PointScan
    from relmap.evaluation.plane_run import PlaneRun


def report_planes(job: Job) -> None:
    """Map walls, and tell what came out.

    Raises
    ------
    typer.Exit
        Where the run was interrupted.
    """
    from relmap.cli.map import each, leave, stopped_after, untied

    summary = map_scans(job).result.summary
    counts, timing = summary["counts"], summary["timing"]
    typer.echo(
        f"{stopped_after(summary)}wrote 9 files to {job.out}: {counts['planes_static']} walls with "
        f"{counts['corners_static']} corners mapped in {counts['iterations']} iterations, "
        f"{each(timing['median_ms'])} beside segmentation" + untied(len(summary["pieces"]) - 1)
    )
    leave(job, summary)


def map_scans(job: Job) -> PlaneRun:
    """Map a log of point scans into a result folder.

    Raises
    ------
    RelmapError
        Where the log cannot be used, or the folder cannot be written; an earlier result in it is
        then as it was.
    """
    from relmap.cli.console import busy
    from relmap.datasets import open_scans
    from relmap.evaluation.plane_run import run_plane_mapper
    from relmap.files import staged_folder
    from relmap.planefiles import write_planes
    from relmap.planes import PlaneMapper
    from relmap.plots.planes import write_planes_png
    from relmap.results import EVALUATION, MAP_PNG, MAPPER, write_result
    from relmap.segmentation import PlaneSegmenter

    source = job.at(job.source)
    with busy("reading"):
        log = open_scans(source, job.log_format)
    if job.interval is not None:
        log = log.between(*job.interval)
    about = _about(job, source)
    with staged_folder(job.at(job.out), stale=[EVALUATION]) as staging, ExitStack() as afterwards:

        def shown(scans: Iterable[PointScan]) -> Iterator[PointScan]:
            yield from job.scans(scans, len(log))
            afterwards.enter_context(busy("refining and writing"))

        seen = journaled_labels(job)
        if len(seen) > len(log):
            raise RelmapError(f"{source} has {len(log)} scans, fewer than journal {job.journal}")
        mapper = job.mapper(PlaneMapper)
        afterwards.callback(mapper.close)
        run = run_plane_mapper(mapper, log, PlaneSegmenter(), about, shown, job.refine, seen)
        write_result(staging, run.result)
        mapper.save(staging / MAPPER)
        write_planes(staging, run.planes)
        write_planes_png(staging / MAP_PNG, run.planes, run.result.poses)
    return run


def _about(job: Job, source: Path) -> dict[str, Any]:
    from relmap.datasets import SCAN_DATASETS

    names = [dataset.name for dataset in SCAN_DATASETS if dataset.recognises(source)]
    return {
        "input": str(job.source),
        "format": job.log_format or (names[0] if len(names) == 1 else None),
        "variant": "planes",
        "seed": 0,
        "configuration": asdict(job.settings),
    }
