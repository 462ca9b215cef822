"""From a log of clouds to a result folder: ``relmap map --variant planes3d``."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import typer

from relmap.cli.console import INTERRUPTED, Counter, busy
from relmap.cli.job import Job

if TYPE_CHECKING:
    from pathlib import Path

    from relmap.datasets.scans import ScanLog
    from relmap.evaluation.space_run import SpaceResult


def report_space(job: Job, voxel_m: float | None) -> None:
    """Map a log of clouds, and report the result.

    Raises `RelmapError` if the log is invalid, or the folder cannot be written; an earlier result
    in it is then unchanged. Raises `typer.Exit` if the run was interrupted.
    """
    from relmap.cli.mapping import stale_files
    from relmap.datasets.scans import ScanLog
    from relmap.evaluation.sources import read_log, recognised_format
    from relmap.evaluation.space_run import VARIANT, run_in_space
    from relmap.io.files import staged_folder
    from relmap.io.results import MAPPER
    from relmap.planes3d import Plane3dMapper
    from relmap.segmentation.space import PatchSegmenter

    with busy("reading"):
        log = read_log(job.source, "planes", job.log_format, job.interval)
    assert isinstance(log, ScanLog)
    _doubt_unit(log)
    about = {
        "input": str(job.source),
        "format": job.log_format or recognised_format(job.source, "planes"),
        "variant": VARIANT,
        "seed": None,
    }
    with staged_folder(job.out, [MAPPER, *stale_files(job.out)]) as staging:
        mapper = Plane3dMapper(PatchSegmenter(voxel_m=voxel_m))
        with closing(Counter("mapping")) as counter:
            result = run_in_space(mapper, log, about, job.refine, job.scans, counter)
        with busy("writing"):
            _write(staging, result)
        n_files = len(list(staging.iterdir()))
    typer.echo(_message(job, result, n_files))
    if result.summary["interrupted"]:
        raise typer.Exit(INTERRUPTED)


def _doubt_unit(log: ScanLog) -> None:
    """Warn of coordinates that are hardly in metres: the map would be as good, in their unit."""
    import numpy as np

    from relmap.cli.outcome import BEYOND_M

    first = next(
        (scan.points_robot for scan in log.scans() if len(scan.points_robot)), np.zeros((1, 3))
    )
    middle_m = float(np.median(np.linalg.norm(first, axis=1)))
    if middle_m > BEYOND_M:
        typer.echo(
            f"relmap: half of the points of a cloud are more than {middle_m:.0f} m away: "
            "coordinates must be in metres",
            err=True,
        )


def _write(folder: Path, result: SpaceResult) -> None:
    from relmap.evaluation.space_run import LEAST_SCANS
    from relmap.io.files import write_tum
    from relmap.io.results import MAP_PNG, write_result
    from relmap.planes3d.files import write_mesh, write_planes3d
    from relmap.plots.planes3d import write_planes3d_png

    write_result(folder, result)
    table = result.planes
    write_planes3d(folder, table)
    write_mesh(folder, next(iter(result.parts), None), table.plane[table.status == "static"])
    for number, (stamps_s, poses) in enumerate(result.paths[1:], start=1):
        if len(poses) >= LEAST_SCANS:
            write_tum(folder / f"submap-{number}.tum", stamps_s, poses)
    write_planes3d_png(folder / MAP_PNG, table, result.poses, result.stamps_s, result.weak)


def _message(job: Job, result: SpaceResult, n_files: int) -> str:
    from relmap.cli.outcome import advice, broken, each

    summary = result.summary
    counts, submaps = summary["counts"], summary["submaps"]
    iterations = counts["iterations"]
    begun = f"stopped after {iterations} of {summary['input_iterations']}: "
    message = (
        f"{begun if summary['interrupted'] else ''}wrote {n_files} files to {job.out}: "
        f"{counts['planes_static']} planes mapped in {iterations} iterations, "
        f"{each(summary['timing']['scan_median_ms'])}"
    )
    if not submaps:
        return f"{message}; no plane was found: the clouds show none, or are not in metres"
    message += broken(submaps)
    if weak := len(summary["weak_links"]):
        message += f"; scans whose position is poorly determined in some direction: {weak}"
    return message + advice(summary)
