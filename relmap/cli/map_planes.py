"""``relmap map --variant planes``: make a map of walls from a log of point scans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from relmap.cli.job import Job, journaled_labels
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.datasets.scans import PointScan, ScanLog
    from relmap.evaluation.plane_evaluate import WallTruth
    from relmap.evaluation.plane_run import PlaneRun
    from relmap.planes import PlaneMapper
    from relmap.plots.bench_recorder import BenchRecorder

BENCH_PNG = "bench.png"
BENCH_GIF = "bench.gif"


def report_planes(job: Job) -> None:
    """Map walls, and tell what came out.

    Raises
    ------
    typer.Exit
        Where the run was interrupted.
    """
    from relmap.cli.outcome import each, leave, stopped_after, torn

    run, n_files = map_scans(job)
    summary = run.result.summary
    counts, timing = summary["counts"], summary["timing"]
    weak = len(summary["weak_links"])
    told = f"; scans between which the robot was taken to go on as before: {weak}" if weak else ""
    typer.echo(
        f"{stopped_after(summary)}wrote {n_files} files to {job.out}: "
        f"{counts['planes_static']} walls with {counts['corners_static']} corners mapped in "
        f"{counts['iterations']} iterations, {each(timing['scan_median_ms'])}"
        + torn(summary)
        + told
    )
    leave(job, summary)


def map_scans(job: Job) -> tuple[PlaneRun, int]:
    """Map a log of point scans into a result folder, with pictures; tell how many files it wrote.

    Raises
    ------
    RelmapError
        Where the log cannot be used, or the folder cannot be written; an earlier result in it is
        then as it was.
    """
    from relmap.cli.console import busy
    from relmap.evaluation.plane_run import run_plane_mapper
    from relmap.io.files import staged_folder
    from relmap.planes import PlaneMapper
    from relmap.plots.bench_recorder import BenchRecorder, frame_step
    from relmap.segmentation import PlaneSegmenter

    source, log, seen = job.at(job.source), _read(job), journaled_labels(job)
    if len(seen) > len(log):
        raise RelmapError(f"{source} has {len(log)} scans, fewer than journal {job.journal}")
    view = log.sensor
    segmenter = PlaneSegmenter(view_rad=view.view_rad, range_m=view.range_m)
    every = frame_step(len(log)) if job.animate else 0
    with (
        staged_folder(job.at(job.out), _stale(job.at(job.out))) as staging,
        ExitStack() as afterwards,
    ):
        mapper = job.mapper(PlaneMapper)
        afterwards.callback(mapper.close)
        before_s = log.stamps_s[: len(seen)].tolist()
        bench = BenchRecorder(mapper, segmenter, _truth_beside(source), every, view, before_s)

        def shown(scans: Iterable[PointScan]) -> Iterator[PointScan]:
            yield from bench.watch(job.scans(scans, len(log)))
            afterwards.enter_context(busy("refining and writing"))

        about = _about(job, source, mapper)
        run = run_plane_mapper(mapper, log, segmenter, about, shown, job.refine, seen)
        _write(staging, run, mapper)
        afterwards.close()
        if len(seen) == len(log):
            bench.see_again(log)
        _draw_bench(staging, bench, job.animate)
        n_files = len(list(staging.iterdir()))
    return run, n_files


def _read(job: Job) -> ScanLog:
    from relmap.cli.console import busy
    from relmap.datasets import open_scans

    with busy("reading"):
        log = open_scans(job.at(job.source), job.log_format)
    return log if job.interval is None else log.between(*job.interval)


def _write(folder: Path, run: PlaneRun, mapper: PlaneMapper) -> None:
    from relmap.io.results import MAP_PNG, MAPPER, write_result
    from relmap.planes.files import write_planes, write_submaps
    from relmap.plots.planes import write_submaps_png

    write_result(folder, run.result)
    mapper.save(folder / MAPPER)
    write_planes(folder, run.planes)
    write_submaps(folder, [(submap.stamps_s, submap.poses) for submap in run.submaps])
    n_apart = len(run.result.summary["submaps"])
    write_submaps_png(folder / MAP_PNG, [(s.planes, s.poses) for s in run.submaps], n_apart)


def _stale(out: Path) -> list[str]:
    """Return the files of an earlier result that this one puts out of date."""
    from relmap.io.results import EVALUATION
    from relmap.planes.files import submap_files

    return [EVALUATION, BENCH_PNG, BENCH_GIF, *submap_files(out)]


def _about(job: Job, source: Path, mapper: PlaneMapper) -> dict[str, Any]:
    from relmap.datasets import SCAN_DATASETS

    names = [dataset.name for dataset in SCAN_DATASETS if dataset.recognises(source)]
    return {
        "input": str(job.source),
        "format": job.log_format or (names[0] if len(names) == 1 else None),
        "variant": "planes",
        "seed": 0,
        "configuration": mapper.settings,
    }


def _draw_bench(folder: Path, bench: BenchRecorder, animate: bool) -> None:
    """Draw the last scan, and where asked for, the animation."""
    from relmap.cli.console import tracked
    from relmap.plots.bench import write_bench_gif, write_bench_png

    last = bench.last()
    if last is None:
        return
    write_bench_png(folder / BENCH_PNG, last)
    if animate:
        frames = [*bench.frames, last]
        write_bench_gif(
            folder / BENCH_GIF, frames, lambda frames: tracked(frames, len(frames), "drawing")
        )


def _truth_beside(source: Path) -> WallTruth | None:
    """Return the true walls of a simulated log, to draw them; None where there are none."""
    from relmap.evaluation.plane_evaluate import read_wall_truth

    folder = source if source.is_dir() else source.parent
    if not (folder / "truth" / "planes.csv").is_file():
        return None
    try:
        return read_wall_truth(folder)
    except RelmapError as error:
        typer.echo(f"relmap: the true walls are not drawn: {error}", err=True)
        return None
