"""``relmap merge``: combine two maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relmap.cli.arguments import Out, refuse_to_write_into
from relmap.cli.console import busy
from relmap.cli.warned import rescaled

if TYPE_CHECKING:
    from relmap.io.results import Result

HELP = """Combine the maps of two result folders.

Both are maps of points or of walls; their logs are not needed. B is aligned to A by common
landmarks with the same relative locations, or by coinciding walls. It is an error if there is no
alignment, or more than one. If a run broke into submaps, only the map is merged. It writes into
DIR the files of 'relmap map' except mapper.npz, report.html and bench.png; tracks.csv.gz is empty,
trajectory.tum is the path of A, and trajectory-2.tum that of B in the same frame. In landmarks.csv
and planes.csv the iterations of B follow those of A. Landmarks keep their ids, if both have been
mapped with ids; an id of B that means another landmark in A gets a new number.

\b
Example:
  relmap merge ground-floor annex -o both
"""


def command(
    one: Annotated[Path, typer.Argument(metavar="A", help="The result that keeps its frame.")],
    other: Annotated[Path, typer.Argument(metavar="B", help="The result that is added.")],
    out: Out,
) -> None:
    """Merge two maps; the help text explains the arguments."""
    import numpy as np

    from relmap.io.files import staged_folder, write_tum
    from relmap.io.results import MAP_PNG, MAPPER, SECOND, stale_files, write_names, write_result
    from relmap.merging.results import merge_results
    from relmap.planes.walls.files import PlaneResult, write_planes
    from relmap.plots.planes import plot_planes
    from relmap.plots.run import plot_run
    from relmap.plots.sheet import write_png

    refuse_to_write_into(out, one, other)
    with busy("merging"):
        merged = merge_results(one, other)
        result = merged.result
        with staged_folder(out, [*stale_files(out), MAPPER]) as staging:
            write_result(staging, result)
            write_tum(staging / SECOND, merged.stamps_s, merged.poses)
            if merged.names:
                write_names(staging, merged.names)
            if isinstance(result, PlaneResult):
                write_planes(staging, result.planes)
                both = np.concatenate([result.poses, merged.poses])
                write_png(staging / MAP_PNG, plot_planes, result.planes, both)
            else:
                write_png(staging / MAP_PNG, plot_run, result)
            n_files = len(list(staging.iterdir()))
    typer.echo(f"wrote {n_files} files to {out}: {_said(result)}")


def _said(result: Result) -> str:
    counts, record = result.summary["counts"], result.summary["merged"]
    walls = "planes_static" in counts
    what = f"{counts.get('mapped')} landmarks"
    if walls:
        what = f"{counts['planes_static']} walls with {counts['corners_static']} corners"
    said = f"{record['common_landmarks']} {'corners' if walls else 'landmarks'} are in both maps"
    apart = int(record.get("different_ids", 0))
    said += f"; {apart} ids mean different landmarks in them" * (apart > 0)
    lengths = rescaled(record.get("lengths"), f"{record['second']} has")
    return f"{what}; {said}{lengths}"
