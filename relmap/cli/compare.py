"""``relmap compare``: many methods on the same data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from relmap.cli.console import Out
from relmap.cli.job import Association
from relmap.cli.plaintable import print_plain, shown
from relmap.cli.simulate import Noise
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.comparison.compare import Compared
    from relmap.evaluation.feeding import Log
    from relmap.evaluation.sources import Data, Source

World = Literal["figure-eight", "building"]

HELP = """Compare methods on the same data: relmap's own, and what people would use instead.

INPUT is a log of landmarks or of point scans, as 'relmap map' takes it; or a world is simulated.
It prints one table and writes DIR/comparison.csv, comparison.png, and of each method
trajectory-METHOD.tum and map-METHOD.png.

\b
Examples:
  relmap compare --simulate figure-eight -o comparison
  relmap compare --simulate figure-eight --dynamic 0.4 --methods relmap-points,ekf -o moving
  relmap compare --simulate building -o walls
  relmap compare log.observations.csv.gz --truth log_ground_truth.txt --association known -o real

\b
Methods for landmarks:
  relmap-points        refined at the end
  relmap-points-live   as the map stands when the log is over
  relmap-points-paper  the paper's settings: nearest of the previous iteration, no refinement
  frame-to-frame *     fits every scan to the one before and chains the steps
  frame-to-map *       fits every scan to the map, then averages it in
  ekf-mrpt *           EKF SLAM without odometry that predicts standing still, as MRPT ships it
  ekf *                the same, linearised where the scan fits the map best
  batch *              sparse least squares over all observations at the end: the limit
  isam2 *+             gtsam's iSAM2
  gtsam-batch *+       gtsam's batch solver
  kiss-icp +           KISS-ICP: a path, no landmarks
  small-gicp +         small_gicp from scan to scan: a path, no landmarks
Methods for point scans:
  relmap-planes, relmap-planes-live, relmap-planes-paper, kiss-icp +, small-gicp +

\b
  * must be told which landmark is which: --association known
  + needs pip install 'relmap[peers]'

\b
The figures:
  RMSE        of landmarks (of walls: corners) after the map was turned and shifted to fit [m]
  of          how many of them there are: those that the method mapped
  RMSE10      the same of those seen at least ten times
  cover       share of the landmarks seen at least ten times that are in the map
  ATE, RPE    error of the path, as a whole and from one step to the next [m]
  path        share of the iterations that have a pose; of several submaps only the largest counts
  pairs, turn mean error against checked relations between poses [m], [rad]
  ms, mean    processor time of an iteration, median and mean [ms]; one thread
  end         the same, median of the last 100 iterations [ms]
  total       of the whole log, with what is done at its end [s]
  MB          how much the process grew
"""

DENSITY = 25.0
RELATIONS = {"pairs": "relation_m", "turn": "relation_rad"}
COLUMNS = {
    "of": "matched",
    "RMSE10": "often_rmse_m",
    "cover": "coverage",
    "ATE": "ate_m",
    "RPE": "rpe_m",
    "path": "path_coverage",
    **RELATIONS,
    "ms": "median_ms",
    "mean": "mean_ms",
    "end": "last_100_median_ms",
    "total": "total_s",
    "MB": "memory_mb",
}


def compare_command(
    out: Out,
    source: Annotated[
        Path | None, typer.Argument(metavar="INPUT", help="The log: a file or a folder.")
    ] = None,
    simulate: Annotated[
        World | None, typer.Option(help="Simulate this world instead of reading a log.")
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(metavar="A,B,...", help="Methods to run; all that can where left out."),
    ] = None,
    association: Annotated[
        Association | None,
        typer.Option(
            help="Whether methods are told which landmark is which; told where left out and the "
            "log has ids."
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="TRUTH",
            help="What to compare with, as 'relmap evaluate' takes it; the folder truth beside "
            "INPUT where left out.",
        ),
    ] = None,
    scans: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Only iterations A to B - 1 of INPUT."),
    ] = None,
    log_format: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="Format of INPUT, if it is not recognised."),
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(
            help="Noise of each coordinate, metres: what is simulated (0.05 where left out), and "
            "what methods are told of a log (estimated from it where left out)."
        ),
    ] = None,
    density: Annotated[
        float, typer.Option(help="Of the figure eight: landmarks per 100 m of the path.")
    ] = DENSITY,
    iterations: Annotated[
        int | None, typer.Option(help="Of a simulated world; one loop where left out.")
    ] = None,
    noise: Annotated[Noise, typer.Option(help="Of a simulated world.")] = "gaussian",
    dynamic: Annotated[
        float, typer.Option(help="Of the figure eight: share of the landmarks that move.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Of a simulated world.")] = 0,
) -> None:
    """Compare; the arguments are explained in the help text."""
    from relmap.cli.arguments import parse_scans
    from relmap.evaluation.sources import FileSource

    given: Source
    if (source is None) == (simulate is None):
        raise RelmapError("compare takes either INPUT, a log, or --simulate with a world")
    if source is not None:
        simulated = (density, iterations, noise, dynamic, seed)
        if simulated != (DENSITY, None, "gaussian", 0.0, 0):
            raise RelmapError(
                "--density, --iterations, --noise, --dynamic and --seed are for --simulate"
            )
        if sigma is not None and not 0 < sigma < 1000:
            raise RelmapError(f"--sigma is {sigma}; it must lie above 0 and below 1000 metres")
        given = FileSource(source, log_format, parse_scans(scans), truth)
    else:
        if truth is not None or scans is not None or log_format is not None:
            raise RelmapError("--truth, --scans and --format are for INPUT, not for --simulate")
        given = _simulated(str(simulate), density, iterations, noise, sigma, dynamic, seed)
    names = [name.strip() for name in methods.split(",")] if methods is not None else None
    rows = compare_into(out, given, names, association, sigma if source else sigma or 0.05)
    ran = sum(row.run is not None for row in rows)
    paths = f"{ran} trajector{'ies' if ran > 1 else 'y'}"
    typer.echo(f"wrote comparison.csv, {paths} and {ran + 1} pictures to {out}")


def _simulated(
    world: str,
    density: float,
    iterations: int | None,
    noise: str,
    sigma: float | None,
    dynamic: float,
    seed: int,
) -> Source:
    from relmap.evaluation.sources import BuildingSource, EightSource

    spread = 0.05 if sigma is None else sigma
    if world == "building":
        if (density, dynamic) != (DENSITY, 0.0):
            raise RelmapError("--density and --dynamic are for the figure eight")
        return BuildingSource(iterations, noise, spread, seed)
    loop = 900 if iterations is None else iterations
    return EightSource(density, loop, noise, spread, dynamic, seed)


def compare_into(
    out: Path,
    source: Source,
    names: Sequence[str] | None = None,
    association: Association | None = None,
    sigma_m: float | None = None,
) -> list[Compared]:
    """Compare methods, print the table and write the files.

    Parameters
    ----------
    out : Path
    source : Source
    names : sequence of str, optional
        All methods that can be given the data where left out.
    association : "nearest" or "known", optional
        Known where left out and the data have ids.
    sigma_m : float, optional
        Noise that the methods are told.

    Raises
    ------
    RelmapError
        Where an argument or the data cannot be used, no method could run, or the folder cannot be
        written.
    """
    from relmap.cli.console import busy
    from relmap.comparison.compare import CSV_COLUMNS, chosen_methods, compare
    from relmap.io.files import atomic_write, staged_folder, write_tum
    from relmap.io.tables import csv_text

    with busy("reading or simulating"):
        data = source.load()
    if association is None:
        association = "nearest" if data.ids is None else "known"
    methods = chosen_methods(names, data, association)
    with staged_folder(out) as staging:
        rows: list[Compared] = []
        running = compare(source, methods, association, sigma_m)
        for number, method in enumerate(methods, 1):
            with busy(f"{method.name}, method {number} of {len(methods)}"):
                rows.append(next(running))
            if rows[-1].note:
                typer.echo(f"relmap: {method.name} {rows[-1].note}", err=True)
        if not any(row.run for row in rows):
            raise RelmapError(f"none of the methods could run: {rows[0].method} {rows[0].note}")
        lines = (row.row(association) for row in rows)
        atomic_write(staging / "comparison.csv", csv_text(CSV_COLUMNS, lines))
        for row in rows:
            if row.run is not None:
                found = row.run.result
                write_tum(staging / f"trajectory-{row.method}.tum", found.stamps_s, found.poses)
        with busy("drawing"):
            draw(staging, rows, data, source.about)
    print_rows(f"{source.about}; association {association}", rows)
    return rows


def draw(folder: Path, rows: Iterable[Compared], data: Data[Log], title: str) -> None:
    """Draw the comparison and the map of every method that ran."""
    from relmap.comparison.compare import overlay_of
    from relmap.evaluation.evaluate import match_walls
    from relmap.planes.files import PlaneResult
    from relmap.plots.comparison import write_comparison_png
    from relmap.plots.planes import write_planes_png
    from relmap.plots.run import write_map_png

    ran = [(row.method, row.run) for row in rows if row.run is not None]
    figures = [(name, run.figures) for name, run in ran]
    write_comparison_png(folder / "comparison.png", figures, title)
    for name, run in ran:
        picture, result = folder / f"map-{name}.png", run.result
        if not isinstance(result, PlaneResult):
            write_map_png(picture, result, truth=overlay_of(run, data), title=name)
            continue
        matched = match_walls(result, data.truth) if data.truth else None
        truth = (data.truth, matched) if data.truth and matched else None
        write_planes_png(picture, result.planes, result.poses, truth, name)


def print_rows(title: str, rows: Iterable[Compared]) -> None:
    """Print the table; methods that did not run stand below it."""
    rows = list(rows)
    ran = [(row.method, row.run.figures) for row in rows if row.run is not None]
    corners = any(figures["corner_rmse_m"] is not None for _, figures in ran)
    of_map = "corner_rmse_m" if corners else "landmark_rmse_m"
    columns = {"RMSE": of_map} | COLUMNS
    related = any(figures["relation_m"] is not None for _, figures in ran)
    left_out = ["RMSE10"] * corners + [*RELATIONS] * (not related)
    columns = {heading: key for heading, key in columns.items() if heading not in left_out}
    cells = [
        [name, *(shown(heading, figures[key]) for heading, key in columns.items())]
        for name, figures in ran
    ]
    print_plain(title, ["method", *columns], cells)
    for row in rows:
        if row.run is None:
            typer.echo(f"{row.method}: {row.note}")
