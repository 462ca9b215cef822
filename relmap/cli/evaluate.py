"""``relmap evaluate``: compare a result with the truth."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from relmap.cli.console import busy, figure, print_table
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.datasets.base import ObservationLog
    from relmap.evaluation.evaluate import Evaluation
    from relmap.evaluation.truth import Judged
    from relmap.io.results import Result

NEVER_KNOWN: dict[str, tuple[str, ...]] = {
    "points": (),
    "planes": ("purity",),
    "planes3d": ("coverage", "landmarks_per_true", "purity"),
}
"""Figures of a variant that no truth provides: null in the file, and not in the table."""

HELP = """Compare a result with the truth.

DIR is a folder that 'relmap map' wrote.  It prints a table and writes DIR/evaluation.json.

\b
TRUTH is
  a folder as 'relmap simulate' writes it
  a trajectory, in the format of TUM or of KITTI (with its times.txt beside it)
  MRPT's ..._ground_truth.txt
  the folder of I-SLSJF's simulation (slsjf-sim), or of MRCLAM (mrclam)
  the folder of Victoria Park: trees mapped by another program, a reference, not a truth
  the folder of DLR's circles: ids without positions, so there is no RMSE
  walls only: a log of point scans with poses, or a .relations file of checked relations
  planes in space only: a log of clouds with poses, or a folder as 'relmap simulate' writes it

\b
Example:
  relmap evaluate result --truth eight

\b
The metrics:
  corner_rmse_m       walls: as landmark_rmse_m, for corners
  false corners       walls: mapped corners that match no true one, and are not in the RMSE
  wall_recall         walls: fraction of the observed length of true walls over 0.5 m
                      that is mapped (within 0.1 m and 5 degrees)
  wall_precision      walls: fraction of the length of mapped walls over 0.5 m that is true
  doubled_length      walls: fraction of the mapped length that is mapped twice
  plane_recall        planes in space: fraction of the true planes, of which two scans saw at least
                      0.25 m2, that are mapped (within 0.05 m and 5 degrees)
  plane_precision     planes in space: fraction of the mapped planes over 0.25 m2 that are true
  plane_rmse_m        planes in space: distance of mapped outlines from the true planes
  doubled_area        planes in space: fraction of the mapped area that is mapped twice
  landmark_rmse_m     root mean square error of the mapped landmarks, after rigid alignment
  coverage            fraction of the landmarks seen at least ten times that are in the map
  landmarks_per_true  mapped landmarks per true one; above 1 if some are mapped twice
  purity              fraction of observations assigned to the correct landmark
  ate_m, rpe_m        absolute and relative error of the path
  relation_m, _rad    walls: mean error against checked relations between poses

A metric that is not available is "-" in the table and null in evaluation.json; if this truth could
provide it, the reason is printed.
"""

FIGURES = {
    "landmark_rmse_m": "landmark RMSE [m]",
    "corner_rmse_m": "corner RMSE [m]",
    "wall_recall": "wall recall",
    "wall_precision": "wall precision",
    "doubled_length": "doubled length",
    "plane_recall": "plane recall",
    "plane_precision": "plane precision",
    "plane_rmse_m": "plane RMSE [m]",
    "doubled_area": "doubled area",
    "coverage": "coverage",
    "landmarks_per_true": "landmarks per true one",
    "purity": "purity",
    "ate_m": "ATE [m]",
    "rpe_m": "RPE [m]",
    "relation_m": "relations [m]",
    "relation_rad": "relations [rad]",
}


def command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The result folder.")],
    truth: Annotated[Path, typer.Option(metavar="TRUTH", help="The truth, as above.")],
    log: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG", help="Points only: the log that was mapped, if it was moved since."
        ),
    ] = None,
) -> None:
    """Evaluate a result; the help text explains the arguments."""
    from relmap.io.results import PLANES

    if (folder / PLANES).exists() and log is not None:
        raise RelmapError("walls and planes have no ids: --log is for a map of points")
    with busy("evaluating"):
        evaluation = evaluate_folder(folder, truth, log)
    print_table(f"{folder} against {truth}", ("metric", "value"), rows_of(evaluation))
    for note in evaluation.notes:
        typer.echo(note)
    merged = any("merged" in note for note in evaluation.notes)  # no log applies to such a map
    if evaluation.purity is None and evaluation.variant == "points" and not merged:
        typer.echo("no log with ids was found: give it with --log to get all metrics")
    typer.echo(f"wrote evaluation.json to {folder}")


def rows_of(*evaluations: Evaluation) -> list[tuple[str, ...]]:
    """Return the rows of a table of evaluations of one variant: names, and figures of each."""
    available = evaluations[0].as_dict()
    variant = evaluations[0].variant
    rows = [
        (name, *(figure(getattr(each, key)) for each in evaluations))
        for key, name in FIGURES.items()
        if key in available and key not in NEVER_KNOWN[variant]
    ]
    if variant == "planes":
        rows.insert(1, ("false corners", *(_false_corners(each.counts) for each in evaluations)))
    return rows


def _false_corners(counts: dict[str, int]) -> str:
    """Return the number of false mapped corners; "-" against a truth without walls."""
    if "false_corners" not in counts:
        return "-"
    false = counts["false_corners"]
    return f"{false} of {false + counts['matched_corners']}"


def evaluate_folder(folder: Path, truth: Path, log: Path | None = None) -> Evaluation:
    """Evaluate a result folder and write its ``evaluation.json``; draw walls over the true ones."""
    from relmap.evaluation.evaluate import evaluate, match_walls
    from relmap.evaluation.truth import read_truth
    from relmap.io.files import atomic_write, staged_folder
    from relmap.io.results import EVALUATION, MAP_PNG, json_text
    from relmap.planes.walls.files import PlaneResult, read_any
    from relmap.planes3d.files import read_result3d
    from relmap.plots.planes import plot_planes
    from relmap.plots.sheet import write_png

    result = read_any(folder)
    judged: Judged = "planes" if isinstance(result, PlaneResult) else "points"
    if result.summary.get("variant") == "planes3d":
        result, judged = read_result3d(folder), "planes3d"
    known = read_truth(truth, judged)
    mapped = find_log(result, truth, log) if judged == "points" else None
    evaluation = evaluate(result, known, mapped)
    with staged_folder(folder) as staging:
        atomic_write(staging / EVALUATION, json_text(evaluation.as_dict()))
        if isinstance(result, PlaneResult) and (matched := match_walls(result, known)):
            shown = result.planes, result.poses, (known, matched)
            write_png(staging / MAP_PNG, plot_planes, *shown)
    return evaluation


def find_log(result: Result, truth: Path, log: Path | None) -> ObservationLog | None:
    """Return the mapped log: the given one, from its original path, or beside the truth."""
    from relmap.datasets import open_log
    from relmap.datasets.observation_csv import FILE_NAMES
    from relmap.evaluation.landmarks import mapped_part
    from relmap.evaluation.sources import read_again

    def read_mapped(path: Path) -> ObservationLog:
        return cast("ObservationLog", read_again(path, "points", result.summary))

    source = result.summary.get("input")
    if log is not None:
        return read_mapped(log)
    beside = truth if truth.is_dir() else truth.parent
    beside = beside.parent if beside.name == "truth" else beside
    candidates: list[tuple[Path, Any]] = [(beside / name, open_log) for name in FILE_NAMES]
    if isinstance(source, str):
        candidates.insert(0, (Path(source), read_mapped))
    for path, read in candidates:
        if path.exists():
            with suppress(RelmapError):
                found: ObservationLog = read(path)
                mapped_part(result, found)
                return found
    return None
