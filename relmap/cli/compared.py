"""The work of ``relmap compare``: running the methods, the table, and the files of each method."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import typer
from numpy.typing import NDArray

from relmap.cli.arguments import Association
from relmap.cli.compare import COLUMNS, OF_CORNERS, RELATIONS
from relmap.cli.console import busy, figure, print_table
from relmap.comparison.compare import CSV_COLUMNS, Compared, chosen_methods, compare
from relmap.comparison.methods.registry import MethodInfo
from relmap.comparison.methods.running import MethodRun
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.evaluation.evaluate import match_walls
from relmap.evaluation.feeding import Log
from relmap.evaluation.landmarks import Overlay, overlay
from relmap.evaluation.sources import Data, Source
from relmap.io.files import atomic_write, staged_folder, write_tum
from relmap.io.results import Result
from relmap.io.tables import columns_text, csv_text
from relmap.planes.walls.files import ENDS, PlaneResult
from relmap.planes3d.files import Plane3dResult


def compare_into(
    out: Path,
    source: Source,
    names: Sequence[str] | None,
    association: Association | None,
    sigma_m: float | None,
) -> list[Compared]:
    """Compare methods, print the table and write the files."""
    with busy("reading or simulating"):
        data = source.load()
    if association is None:
        association = "nearest" if data.ids is None else "known"
    methods = chosen_methods(names, data, association)
    with staged_folder(out) as staging:
        rows = list(_compared(source, methods, association, sigma_m))
        if not any(row.run for row in rows):
            raise RelmapError(f"none of the methods could run: {rows[0].method} {rows[0].note}")
        lines = (row.row(association) for row in rows)
        atomic_write(staging / "comparison.csv", csv_text(CSV_COLUMNS, lines))
        for row in rows:
            if row.run is not None:
                found = row.run.result
                write_tum(staging / f"trajectory-{row.method}.tum", found.stamps_s, found.poses)
                atomic_write(staging / f"map-{row.method}.csv", columns_text(_map_of(found)))
        with busy("drawing"):
            draw(staging, rows, data, source.about)
    unused = association == "nearest" and data.ids is not None
    ids = ", the ids of the log are not used" if unused else ""
    _print_rows(f"{source.about}; association {association}{ids}", rows)
    return rows


def _compared(
    source: Source,
    methods: Sequence[MethodInfo],
    association: Association,
    sigma_m: float | None,
) -> Iterator[Compared]:
    """Run the methods, and report on stderr those that failed."""
    running = compare(source, methods, association, sigma_m)
    for number, method in enumerate(methods, 1):
        with busy(f"{method.name}, method {number} of {len(methods)}"):
            row = next(running)
        if row.note and not method.missing:
            typer.echo(f"relmap: {method.name} {row.note}", err=True)
        yield row


def _print_rows(title: str, rows: Sequence[Compared]) -> None:
    """Print the table, followed by the notes, also on the methods that did not run."""
    ran = [(row.method, row.run.figures) for row in rows if row.run is not None]
    columns = dict(COLUMNS)
    if any(figures["corner_rmse_m"] is not None for _, figures in ran):
        columns |= OF_CORNERS
        del columns["RMSE10"]
    if all(figures["relation_m"] is None for _, figures in ran):
        columns = {heading: of for heading, of in columns.items() if heading not in RELATIONS}
    cells = [
        [name, *(figure(figures[key], kind) for key, kind in columns.values())]
        for name, figures in ran
    ]
    print_table(title, ["method", *columns], cells)
    for row in rows:
        for note in [row.note] if row.run is None else row.run.notes:
            typer.echo(f"{row.method}: {note}")


def _map_of(result: Result) -> dict[str, NDArray[Any]]:
    """Return the columns of a map: landmarks, or the ends of walls."""
    table, mapped = result.landmarks.columns(), result.mapped
    names: tuple[str, ...] = ("landmark", "x", "y", "z")
    if isinstance(result, PlaneResult):
        table, names = result.planes.columns(), ("plane", *ENDS)
        mapped = result.planes.status == "static"
    return {name: table[name][mapped] for name in names}


def draw(folder: Path, rows: Iterable[Compared], data: Data[Log], title: str) -> None:
    """Draw the comparison, and the map or the errors of every method that ran."""
    from relmap.plots.comparison import plot_comparison, plot_errors, shared_scale
    from relmap.plots.of_mapper import plot_result
    from relmap.plots.run import plot_run
    from relmap.plots.sheet import write_png

    ran = [(row.method, row.run) for row in rows if row.run is not None]
    figures = [(name, run.figures) for name, run in ran]
    write_png(folder / "comparison.png", plot_comparison, figures, title)
    overlays = {name: _overlay(run.result, data) for name, run in ran}
    scale = shared_scale([each for each in overlays.values() if each])
    for name, run in ran:
        picture, truth = folder / f"map-{name}.png", overlays[name]
        if isinstance(run.result, PlaneResult):
            _draw_walls(picture, run.result, data, name)
        elif isinstance(run.result, Plane3dResult):
            write_png(picture, plot_result, run.result)
        elif truth is not None:
            write_png(picture, plot_errors, run.result, truth, scale, _titled(name, run))
        else:
            write_png(picture, plot_run, run.result, title=name)


def _titled(name: str, run: MethodRun) -> str:
    rmse_m, ate_m = (run.figures[key] for key in ("landmark_rmse_m", "ate_m"))
    message = [f"RMSE {figure(rmse_m)} m"] if rmse_m is not None else []
    message += [f"ATE {figure(ate_m)} m"] if ate_m is not None else []
    return f"{name}: {', '.join(message)}" if message else name


def _overlay(result: Result, data: Data[Log]) -> Overlay | None:
    """Return the truth in the frame of a map of points, if known."""
    if data.truth is None or isinstance(result, PlaneResult | Plane3dResult):
        return None
    log = data.log if isinstance(data.log, ObservationLog) else None
    return overlay(result, data.truth, log)


def _draw_walls(picture: Path, result: PlaneResult, data: Data[Log], name: str) -> None:
    from relmap.plots.planes import plot_planes
    from relmap.plots.sheet import write_png

    matched = match_walls(result, data.truth) if data.truth else None
    known = (data.truth, matched) if data.truth and matched else None
    write_png(picture, plot_planes, result.planes, result.poses, known, name)
