"""``relmap map --variant planes``: make a map of walls from a log of point scans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from relmap.core.config import MapperConfig
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.datasets.scans import PointScan
    from relmap.evaluation.plane_evaluate import WallTruth
    from relmap.evaluation.plane_run import PlaneRun
    from relmap.figures.bench import BenchRecorder

BENCH_PNG = "bench.png"
BENCH_GIF = "bench.gif"


def map_scans(
    source: Path,
    out: Path,
    settings: MapperConfig,
    interval: tuple[int, int] | None,
    log_format: str | None,
    refine: bool,
    animate: bool = False,
) -> PlaneRun:
    """Map a log of point scans into a result folder, with pictures; `animate` adds an animation.

    Raises
    ------
    RelmapError
        Where the log cannot be used, or the folder cannot be written; an earlier result in it is
        then as it was.
    """
    from relmap.cli.console import busy, tracked
    from relmap.datasets import open_scans
    from relmap.evaluation.plane_run import run_plane_mapper
    from relmap.figures.bench import BenchRecorder, frame_step
    from relmap.files import staged_folder
    from relmap.planefiles import write_planes
    from relmap.planes import PlaneMapper
    from relmap.plots.planes import write_planes_png
    from relmap.results import MAP_PNG, write_result
    from relmap.segmentation import PlaneSegmenter

    with busy("reading"):
        log = open_scans(source, log_format)
    if interval is not None:
        log = log.between(*interval)
    about = _about(source, log_format, settings)
    mapper, view = PlaneMapper(settings), log.sensor
    segmenter = PlaneSegmenter(view_rad=view.view_rad, range_m=view.range_m)
    every = frame_step(len(log)) if animate else 0
    bench = BenchRecorder(mapper, segmenter, _truth_beside(source), every, view)
    with staged_folder(out, _stale(animate)) as staging, ExitStack() as afterwards:

        def shown(scans: Iterable[PointScan]) -> Iterator[PointScan]:
            yield from bench.watch(tracked(scans, len(log), "mapping"))
            afterwards.enter_context(busy("refining and writing"))

        run = run_plane_mapper(mapper, log, segmenter, about, shown, refine=refine)
        write_result(staging, run.result)
        write_planes(staging, run.planes)
        write_planes_png(staging / MAP_PNG, run.planes, run.result.poses)
        afterwards.close()
        _draw_bench(staging, bench, animate)
    return run


def _stale(animate: bool) -> list[str]:
    """Return the files of an earlier result that this one puts out of date."""
    from relmap.results import EVALUATION

    return [EVALUATION] if animate else [EVALUATION, BENCH_GIF]


def _about(source: Path, log_format: str | None, settings: MapperConfig) -> dict[str, Any]:
    from relmap.datasets import SCAN_DATASETS

    names = [dataset.name for dataset in SCAN_DATASETS if dataset.recognises(source)]
    return {
        "input": str(source),
        "format": log_format or (names[0] if len(names) == 1 else None),
        "variant": "planes",
        "seed": 0,
        "configuration": asdict(settings),
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
