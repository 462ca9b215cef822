"""``relmap map --variant planes``: make a map of walls from a log of point scans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from relmap.core.config import MapperConfig

if TYPE_CHECKING:
    from relmap.datasets.scans import PointScan
    from relmap.evaluation.plane_run import PlaneRun


def map_scans(
    source: Path,
    out: Path,
    settings: MapperConfig,
    interval: tuple[int, int] | None,
    log_format: str | None,
    refine: bool,
) -> PlaneRun:
    """Map a log of point scans into a result folder.

    Raises
    ------
    RelmapError
        Where the log cannot be used, or the folder cannot be written; an earlier result in it is
        then as it was.
    """
    from relmap.cli.console import busy, tracked
    from relmap.datasets import SCAN_DATASETS, open_scans
    from relmap.evaluation.plane_run import run_plane_mapper
    from relmap.files import staged_folder
    from relmap.planefiles import write_planes
    from relmap.planes import PlaneMapper
    from relmap.plots.planes import write_planes_png
    from relmap.results import EVALUATION, MAP_PNG, write_result

    with busy("reading"):
        log = open_scans(source, log_format)
    if interval is not None:
        log = log.between(*interval)
    names = [dataset.name for dataset in SCAN_DATASETS if dataset.recognises(source)]
    about = {
        "input": str(source),
        "format": log_format or (names[0] if len(names) == 1 else None),
        "variant": "planes",
        "seed": 0,
        "configuration": asdict(settings),
    }
    with staged_folder(out, stale=[EVALUATION]) as staging, ExitStack() as afterwards:

        def shown(scans: Iterable[PointScan]) -> Iterator[PointScan]:
            yield from tracked(scans, len(log), "mapping")
            afterwards.enter_context(busy("refining and writing"))

        mapper = PlaneMapper(settings)
        run = run_plane_mapper(mapper, log, about=about, progress=shown, refine=refine)
        write_result(staging, run.result)
        write_planes(staging, run.planes)
        write_planes_png(staging / MAP_PNG, run.planes, run.result.poses)
    return run
