"""``relmap sweep``: a grid of experiments."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

import typer

from relmap.cli.arguments import Out, refuse
from relmap.cli.compare import COLUMNS, OF_CORNERS
from relmap.cli.console import counted, figure, print_table, tracked
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.comparison.sweep import Finished
    from relmap.comparison.sweep_spec import Cell

HELP = """Run a grid of simulated experiments on all cores or a cluster.

SPEC is a small TOML file.  Each key has one value or a list; every combination is one cell.

\b
  method = ["relmap-points", "ekf-mrpt"]   # as 'relmap compare --help' lists them
  sigma = [0.05, 0.1]                      # noise, metres
  noise = ["gaussian", "uniform"]
  density = [25, 100]                      # landmarks per 100 m of the path
  dynamic = [0.0, 0.4]                     # fraction of moving landmarks
  seed = "0:10"                            # 0 to 9; or a list
  iterations = 900
  association = "known"                    # or "nearest"
  world = "figure-eight"                   # or "building"

Every finished cell is stored in DIR/cells: after an interruption the same command continues. At the
end it prints the medians over the seeds and writes

\b
  DIR/sweep.csv      one row per cell; independent of the number of workers
  DIR/sweep.parquet  the same table (needs pip install 'relmap[parquet]')
  DIR/sweep.png      the errors over the first number that was varied
  DIR/timing.csv     times per iteration; measure with --workers 1

\b
Examples:
  relmap sweep noise.toml -o noise
  relmap sweep noise.toml -o noise --dask tcp://192.168.0.1:8786

On a cluster relmap is installed on every machine; 'dask scheduler' and 'dask worker ADDRESS' start
them (pip install 'relmap[cluster]'). Work of a failed machine is given to the others.
"""

AXES = {"sigma": "noise [m]", "density": "landmarks per 100 m", "dynamic": "fraction moving"}
"""Axis labels of the varied keys."""
MEDIANS = ("RMSE", "of", "cover", "ATE", "RPE", "ms", "mean")
"""Columns of `relmap compare` whose medians are printed."""


def command(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="What to run: a TOML file.")],
    out: Out,
    workers: Annotated[
        int | None, typer.Option(help="Processes; one per core if not given.")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Run on the workers of this dask scheduler."),
    ] = None,
) -> None:
    """Sweep; the help text explains the arguments."""
    from relmap.comparison.sweep_spec import cells_of
    from relmap.io.files import read_toml

    refuse(workers is not None and workers < 1, f"--workers is {workers}; it must be 1 or more")
    both = workers is not None and dask is not None
    refuse(both, "--workers applies to this machine; with --dask the cluster has its own")
    cells = read_toml(spec, cells_of)
    finished = _sweep_into(out, cells, -1 if workers is None else workers, dask)
    _print_medians(cells, finished)
    notes = {f"{c.method}: {f.note}" for c, f in zip(cells, finished, strict=True) if f.note}
    for note in sorted(notes):
        typer.echo(f"relmap: {note}", err=True)
    typer.echo(f"wrote {counted(len(cells), 'cell')} to {out}")


def _sweep_into(
    out: Path, cells: Sequence[Cell], workers: int, scheduler: str | None
) -> list[Finished]:
    from relmap.comparison.sweep import CellStore, run_cells

    store = CellStore(out)
    before = ((cell, store.load(cell)) for cell in cells)
    found = {cell: done for cell, done in before if done is not None}
    left = [cell for cell in cells if cell not in found]
    if found:
        typer.echo(f"relmap: {len(found)} of {len(cells)} cells were finished before", err=True)
    n = len(left)
    running = run_cells(left, workers, scheduler) if left else ()
    try:
        for cell, finished in tracked(running, n, "cells", 0.0):
            store.save(cell, finished)
            found[cell] = finished
    except KeyboardInterrupt:
        typer.echo(
            f"relmap: {len(found)} of {len(cells)} cells are finished; "
            "the same command continues with the others",
            err=True,
        )
        # Its warning that it cancels the others comes when its generator is deleted.
        warnings.filterwarnings("ignore", module="joblib")
        raise
    rows = [found[cell] for cell in cells]
    _write(out, cells, rows)
    return rows


def _write(out: Path, cells: Sequence[Cell], rows: Sequence[Finished]) -> None:
    from relmap.comparison.sweep import accuracy_csv, times_csv, write_parquet
    from relmap.io.files import atomic_write, staged_folder

    parquet = "sweep.parquet"
    with staged_folder(out, [parquet]) as staging:
        atomic_write(staging / "sweep.csv", accuracy_csv(cells, rows))
        atomic_write(staging / "timing.csv", times_csv(cells, rows))
        _draw(staging, cells, rows)
        try:
            write_parquet(staging / parquet, cells, rows)
        except RelmapError as error:
            if not isinstance(error.__cause__, ImportError):
                raise
            typer.echo(f"relmap: {error}", err=True)


def _draw(out: Path, cells: Sequence[Cell], rows: Sequence[Finished]) -> None:
    """Draw the errors over the first varied number, a line for each of the others."""
    from relmap.comparison.sweep_spec import varying
    from relmap.plots.comparison import SweepRow, plot_sweep
    from relmap.plots.sheet import write_png

    keys = varying(cells)
    along = next((key for key in keys if not isinstance(getattr(cells[0], key), str)), None)
    others = [key for key in keys if key != along]
    drawn = [
        SweepRow(
            ", ".join([cell.method, *(f"{key} {getattr(cell, key)}" for key in others)]),
            None if along is None else float(getattr(cell, along)),
            done.figures,
        )
        for cell, done in zip(cells, rows, strict=True)
    ]
    write_png(out / "sweep.png", plot_sweep, drawn, AXES.get(along or "", along or ""))


def _print_medians(cells: Sequence[Cell], finished: Sequence[Finished]) -> None:
    """Print the medians over the seeds, one row per combination of the other keys."""
    from relmap.comparison.sweep_spec import varying

    keys = varying(cells)
    rows: dict[tuple[Any, ...], list[Finished]] = {}
    for cell, done in zip(cells, finished, strict=True):
        rows.setdefault((*(getattr(cell, key) for key in keys), cell.method), []).append(done)
    of_map = OF_CORNERS if cells[0].world == "building" else {}
    columns = {heading: (COLUMNS | of_map)[heading] for heading in MEDIANS}
    table = [
        [method, *map(str, of), *(_median(group, *at) for at in columns.values()), str(len(group))]
        for (*of, method), group in sorted(rows.items(), key=itemgetter(0))
    ]
    print_table("medians over the seeds", ["method", *keys, *columns, "seeds"], table)


def _median(group: Sequence[Finished], key: str, kind: str) -> str:
    values = [value for done in group if (value := done.figures[key]) is not None]
    return figure(median(values) if values else None, kind)
