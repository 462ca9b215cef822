"""``relmap evaluate``: compare a result with the truth."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relmap.cli.console import busy, figure, print_table
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.datasets.base import ObservationLog
    from relmap.evaluation.evaluate import Evaluation
    from relmap.io.results import Result

HELP = """Tell how good a result is where the truth is known.

DIR is a folder that 'relmap map' wrote.  It prints a table and writes DIR/evaluation.json.

\b
TRUTH is
  a folder as 'relmap simulate' writes it
  MRPT's ..._ground_truth.txt
  the folder of I-SLSJF's simulation (slsjf-sim)
  the folder of Victoria Park: trees as another program mapped them, a reference and no truth
  the folder of DLR's circles: ids without places, so there is no RMSE
  of walls also a log of point scans, for its poses, or a .relations file of checked relations

\b
Example:
  relmap evaluate result --truth eight

\b
The figures:
  corner_rmse_m       of walls: as landmark_rmse_m, of their corners
  false corners       of walls: mapped corners that match no true one, and are not in the RMSE
  wall_recall         of walls: share of the true walls over 0.5 m, as far as they were seen,
                      on which a mapped one lies (within 0.1 m and 5 degrees)
  wall_precision      of walls: share of the mapped walls over 0.5 m that lie on true ones
  doubled_length      of walls: share of the mapped length on which another mapped wall lies
  landmark_rmse_m     how far the mapped landmarks are from their true places, after the map
                      was turned and shifted to fit (root mean square, metres)
  coverage            share of the landmarks seen at least ten times that are in the map
  landmarks_per_true  mapped landmarks per true one; above 1, some stand there twice
  purity              share of observations given to the right landmark
  ate_m, rpe_m        error of the robot's path: as a whole, and from one step to the next
  relation_m, _rad    of walls: mean error against checked relations between poses

A figure that cannot be had is "-" in the table and null in evaluation.json; where this truth could
give it, the reason is told.
"""

FIGURES = {
    "landmark_rmse_m": "landmark RMSE [m]",
    "corner_rmse_m": "corner RMSE [m]",
    "wall_recall": "walls found",
    "wall_precision": "mapped walls right",
    "doubled_length": "wall length doubled",
    "coverage": "coverage",
    "landmarks_per_true": "landmarks per true one",
    "purity": "purity",
    "ate_m": "ATE [m]",
    "rpe_m": "RPE [m]",
    "relation_m": "relations [m]",
    "relation_rad": "relations [rad]",
}
BESIDE = ("observations.csv", "observations.csv.gz")
"""Logs that are looked for beside the truth."""


def evaluate_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The result folder.")],
    truth: Annotated[Path, typer.Option(metavar="TRUTH", help="The truth, as above.")],
    log: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG",
            help="Of points, the log that was mapped, if it was moved since then.",
        ),
    ] = None,
) -> None:
    """Evaluate a result; the help text explains the arguments."""
    from relmap.planes.files import PLANES

    if (folder / PLANES).exists() and log is not None:
        raise RelmapError("walls have no ids: --log is for a map of points")
    with busy("evaluating"):
        evaluation = evaluate_folder(folder, truth, log)
    print_table(f"{folder} against {truth}", ("figure", "value"), rows_of(evaluation))
    for note in evaluation.notes:
        typer.echo(note)
    if evaluation.purity is None and evaluation.variant == "points":
        typer.echo("no log with ids was found: give it with --log to have every figure")
    typer.echo(f"wrote evaluation.json to {folder}")


def rows_of(*evaluations: Evaluation) -> list[tuple[str, ...]]:
    """Return the rows of a table of evaluations of one variant: names, and figures of each."""
    told = evaluations[0].as_dict()
    walls = evaluations[0].variant == "planes"
    rows = [
        (name, *(figure(getattr(each, key)) for each in evaluations))
        for key, name in FIGURES.items()
        if key in told and not (walls and key == "purity")
    ]
    if walls:
        rows.insert(1, ("false corners", *(_false_corners(each.counts) for each in evaluations)))
    return rows


def _false_corners(counts: dict[str, int]) -> str:
    """Return how many of the mapped corners are false; "-" against a truth without walls."""
    if "false_corners" not in counts:
        return "-"
    false = counts["false_corners"]
    return f"{false} of {false + counts['matched_corners']}"


def evaluate_folder(folder: Path, truth: Path, log: Path | None = None) -> Evaluation:
    """Evaluate a result folder and write its ``evaluation.json``; draw walls in the true ones.

    Raises
    ------
    RelmapError
        Where the result, the truth or the log cannot be used, or the file cannot be written.
    """
    from relmap.evaluation.evaluate import evaluate, match_walls
    from relmap.evaluation.truth import read_truth
    from relmap.io.files import atomic_write
    from relmap.io.results import EVALUATION, MAP_PNG, json_text
    from relmap.planes.files import PlaneResult, read_any
    from relmap.plots.planes import write_planes_png

    result = read_any(folder)
    walls = isinstance(result, PlaneResult)
    known = read_truth(truth, "planes" if walls else "points")
    evaluation = evaluate(result, known, None if walls else find_log(result, truth, log))
    atomic_write(folder / EVALUATION, json_text(evaluation.as_dict()))
    if isinstance(result, PlaneResult) and (matched := match_walls(result, known)):
        write_planes_png(folder / MAP_PNG, result.planes, result.poses, (known, matched))
    return evaluation


def find_log(result: Result, truth: Path, log: Path | None) -> ObservationLog | None:
    """Return the log that was mapped: the one given, where it was then, or beside the truth.

    Raises
    ------
    RelmapError
        Where the log given cannot be read.
    """
    from relmap.datasets import open_log
    from relmap.evaluation.landmarks import mapped_part
    from relmap.evaluation.sources import recognised_format

    source, form = result.summary.get("input"), result.summary.get("format")
    form = form if isinstance(form, str) else None
    if log is not None:
        return open_log(log, recognised_format(log, "points") or form)
    beside = truth if truth.is_dir() else truth.parent
    beside = beside.parent if beside.name == "truth" else beside
    candidates: list[tuple[Path, str | None]] = [(beside / name, None) for name in BESIDE]
    if isinstance(source, str):
        candidates.insert(0, (Path(source), form))
    for path, name in candidates:
        if path.exists():
            with suppress(RelmapError):
                found = open_log(path, name)
                mapped_part(result, found)
                return found
    return None
