"""From a log to a result folder, for `relmap map`, `resume` and `demo`."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, cast

import numpy as np
import typer

from relmap.cli.arguments import Association, read_config
from relmap.cli.console import Counter, busy, tracked
from relmap.cli.job import Job, journaled_labels, log_of, require_dimension
from relmap.core.errors import RelmapError
from relmap.datasets.own_table import OwnTable
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import AnyMapper, Log, preparation, segmenter_for
from relmap.evaluation.run import Run, run_mapper, write_tables
from relmap.evaluation.sources import recognised_format
from relmap.evaluation.truth import Truth, read_truth
from relmap.io import results
from relmap.io.files import staged_folder
from relmap.planes import PlaneMapper
from relmap.planes.walls.files import PlaneResult
from relmap.plots.bench_recorder import BenchRecorder, frame_step
from relmap.plots.live import LiveView
from relmap.points import PointMapper


def map_input(source: Path, out: Path, association: Association) -> Run:
    """Map a log of points into a result folder with the usual settings; see `map_log`."""
    settings = read_config(None)
    job = Job(source=source, out=out, settings=settings, association=association, odometry="auto")
    return map_log(job)[0]


def map_log(job: Job) -> tuple[Run, int]:
    """Map a log into a result folder, with pictures.

    Returns `n_files`: number of files written. Raises `RelmapError` if an argument or the log is
    invalid, or the folder cannot be written; an earlier result in it is then unchanged.
    """
    began, out = monotonic(), job.at(job.out)
    _keep_inputs(job, out)
    log = log_of(job)
    with staged_folder(out, results.stale_files(out)) as staging:
        run = _mapped_into(staging, job, log, began)
        run.result.summary["timing"]["total_s"] = monotonic() - began
        write_tables(staging, run.result)
        return run, len(list(staging.iterdir()))


def _keep_inputs(job: Job, out: Path) -> None:
    """Raise an error if the run would overwrite or remove its own log or journal."""
    names = {results.LANDMARKS, results.TRACKS, results.TRAJECTORY, results.SUBMAPS}
    names |= {results.MAP_PLY, results.MAP_PNG, results.SUMMARY, results.MAPPER}
    names |= {*results.stale_files(out)}
    for kind, path in (("log", job.at(job.source)), ("journal", job.journal)):
        if path is None or os.path.realpath(path.parent) != os.path.realpath(out):
            continue
        if path.name in names or any(map(path.match, results.OF_SUBMAPS)):
            other = "give it another name" if kind == "journal" else "write to another folder"
            raise RelmapError(f"{kind} {path} would be overwritten by the result: {other}")


def _mapped_into(folder: Path, job: Job, log: Log, began: float) -> Run:
    """Map a log opened at `began`, and write pictures and the state into an existing folder."""
    seen, about = journaled_labels(job, log), _about(job, log)
    with ExitStack() as afterwards:
        counter = afterwards.enter_context(closing(Counter("mapping")))
        bench = _bench(job, log)
        mapper = job.mapper(bench.see if bench else None)
        afterwards.callback(mapper.close)
        walls = cast("PlaneMapper", mapper)  # where there is a bench
        if bench is not None and job.onto is not None:
            bench.n_before = mapper.n_iterations
        view = afterwards.enter_context(closing(LiveView(job.live_file))) if job.live else None

        def watched(scans: Iterable[Any]) -> Iterator[Any]:
            followed: Iterable[Any] = job.scans(scans)
            if job.onto is not None:
                followed = _taken_up(mapper, log, followed, about)
            followed = view.watch(mapper, followed) if view else followed
            yield from bench.watch(walls, followed) if bench else followed
            counter.close()
            afterwards.enter_context(busy("refining and writing"))

        opened_s = monotonic() - began
        run = run_mapper(
            mapper,
            log,
            job.association,
            about,
            watched,
            job.refine,
            seen,
            bench.segmenter if bench else None,
            job.odometry == "auto",
            counter,
        )
        run.result.summary["timing"]["reading_s"] += opened_s
        if view is not None:
            view.show(mapper)
        if job.onto is not None:
            _note_tie(run, mapper, log)
        _write(folder, run, job, getattr(log, "names", None))
        mapper.save(folder / results.MAPPER)
    if bench is not None:
        _draw_bench(folder, bench, walls, job.animate)
    return run


def _taken_up(
    mapper: AnyMapper, log: Log, scans: Iterable[Any], about: dict[str, Any]
) -> Iterator[Any]:
    """Yield scans, and add them to an existing map from the first one localised there."""
    require_dimension(about["input"], log, mapper, about["onto"])
    prepare, tied = preparation(mapper, log), False
    for scan in scans:
        if not tied and isinstance(mapper, PlaneMapper):
            mapper.take_up(prepare(scan.points_robot), scan.points_robot)
            tied = True  # or not: `finish` decides
        elif not tied and isinstance(mapper, PointMapper):
            tied = mapper.take_up(prepare(scan.points_robot))
            about["tied_at"] = scan.iteration if tied else None
        yield scan


def _note_tie(run: Run, mapper: AnyMapper, log: Log) -> None:
    """Record in the summary where a log was joined to an earlier map, also if at the end only."""
    summary = run.result.summary
    begun, tied_at = mapper.n_iterations - summary["counts"]["iterations"], None
    if isinstance(mapper, PlaneMapper):
        tied_at = mapper.tied_at
    elif summary["tied_at"] is None:
        known = np.isfinite(mapper.trajectory[:, 0, 0])
        new = begun + np.flatnonzero(known[begun:])
        tied_at = int(new[0]) if known[:begun].any() and len(new) else None
    if tied_at is not None:
        summary["tied_at"] = log.first_iteration + tied_at - begun


def _about(job: Job, log: Log) -> dict[str, Any]:
    form = job.log_format or (OwnTable.name if job.columns else None)
    about: dict[str, Any] = {
        "input": str(job.source),
        "format": form or recognised_format(job.at(job.source), job.variant),
        "columns": job.columns,
        "topics": list(job.topics),
        "variant": job.variant,
        **({"level": job.level, "segmenter": job.segmenter} if job.variant == "planes" else {}),
        "seed": 0 if job.variant == "planes" else None,
        "onto": None if job.onto is None else str(job.onto),
        "tied_at": None,
    }
    if job.variant == "points":
        weighed = getattr(log, "covariances", None) is not None
        about |= {"weighed": weighed, "sigmas": job.sigmas}
    return about


def _write(folder: Path, run: Run, job: Job, names: Sequence[str] | None) -> None:
    from relmap.plots.of_mapper import write_pictures

    if isinstance(run.result, PlaneResult) and not run.result.drawn:
        raise RelmapError(
            f"{job.source}: no wall was found in any scan; expected scans of upright walls, metres "
            "(for planes of any direction: --variant planes3d)"
        )
    if names and job.association == "known":
        results.write_names(folder, dict(enumerate(names)))
    write_pictures(folder, run.result, run.groups, job.command, job.source.name)


def _bench(job: Job, log: Log) -> BenchRecorder | None:
    """Return the recorder of wall mapping; None for other variants."""
    if job.variant != "planes" or not isinstance(log, ScanLog):
        return None
    every = frame_step(len(log)) if job.animate else 0
    segmenter, truth = segmenter_for(log.sensor, job.segmenter), _truth_beside(job.at(job.source))
    return BenchRecorder(log, segmenter, truth, every)


def _draw_bench(folder: Path, bench: BenchRecorder, mapper: PlaneMapper, animate: bool) -> None:
    from relmap.plots.bench import plot_bench, write_bench_gif
    from relmap.plots.sheet import write_png

    last = bench.frame(mapper)
    write_png(folder / results.BENCH_PNG, plot_bench, last)
    if animate:
        show = partial(tracked, total=len(bench.frames) + 1, what="drawing")
        write_bench_gif(folder / results.BENCH_GIF, [*bench.frames, last], show)


def _truth_beside(source: Path) -> Truth | None:
    """Return the true walls of a simulated log, to draw them; None if there are none."""
    folder = source if source.is_dir() else source.parent
    if not (folder / "truth" / "planes.csv").is_file():
        return None
    try:
        return read_truth(folder, "planes")
    except RelmapError as error:
        typer.echo(f"relmap: the true walls are not drawn: {error}", err=True)
        return None
