"""``relmap sweep``: a grid of experiments."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated

import typer

from relmap.cli.console import Out
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.comparison.sweep import Finished
    from relmap.comparison.sweep_spec import Cell

HELP = """Run a grid of experiments in simulated worlds, in all cores or on a cluster.

SPEC is a small TOML file.  Each key has one value or a list; every combination is one cell.

\b
  method = ["relmap-points", "ekf-mrpt"]   # as 'relmap compare --help' lists them
  sigma = [0.05, 0.1]                      # noise, metres
  noise = ["gaussian", "uniform"]
  density = [25, 100]                      # landmarks per 100 m of the path
  dynamic = [0.0, 0.4]                     # share of the landmarks that move
  seed = "0:10"                            # 0 to 9; or a list
  iterations = 900
  association = "known"                    # or "nearest"
  world = "figure-eight"                   # or "building"

Every finished cell is kept in DIR/cells: after an interruption the same command goes on where it
was.  At the end it prints the medians over the seeds and writes

\b
  DIR/sweep.csv      one row per cell; the same whatever the number of workers
  DIR/sweep.parquet  the same table (needs pip install 'relmap[parquet]')
  DIR/timing.csv     how long an iteration took; measure with --workers 1

\b
Examples:
  relmap sweep noise.toml -o noise
  relmap sweep noise.toml -o noise --dask tcp://192.168.0.1:8786

On a cluster relmap is installed on every machine; 'dask scheduler' and 'dask worker ADDRESS' start
the two sides (pip install 'relmap[cluster]').  Work of a machine that fails goes to the others.
"""

EVERY_S = 10.0
"""Between two lines of progress where there is no terminal."""


def sweep_command(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="What to run: a TOML file.")],
    out: Out,
    workers: Annotated[
        int | None, typer.Option(help="Processes; one for each core where left out.")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Run on the workers of this dask scheduler."),
    ] = None,
) -> None:
    """Sweep; the arguments are explained in the help text."""
    from relmap.comparison.sweep_spec import read_spec

    if workers is not None and workers < 1:
        raise RelmapError(f"--workers is {workers}; it must be 1 or more")
    if workers is not None and dask is not None:
        raise RelmapError("--workers is for this machine; with --dask the cluster has its own")
    cells = read_spec(spec)
    finished = sweep_into(out, cells, -1 if workers is None else workers, dask)
    _print_medians(cells, finished)
    notes = {f"{c.method}: {f.note}" for c, f in zip(cells, finished, strict=True) if f.note}
    for note in sorted(notes):
        typer.echo(f"relmap: {note}", err=True)
    typer.echo(f"wrote {len(cells)} cells to {out}")


def sweep_into(
    out: Path, cells: Sequence[Cell], workers: int = -1, scheduler: str | None = None
) -> list[Finished]:
    """Run what is not finished yet, and write the tables.

    Raises
    ------
    RelmapError
        Where the folder cannot be written or the scheduler cannot be reached.
    """
    from relmap.comparison.sweep import (
        CellStore,
        accuracy_csv,
        run_cells,
        times_csv,
        write_parquet,
    )
    from relmap.io.files import atomic_write

    store = CellStore(out)
    before = ((cell, store.load(cell)) for cell in cells)
    found = {cell: done for cell, done in before if done is not None}
    left = [cell for cell in cells if cell not in found]
    if len(left) < len(cells):
        done = len(cells) - len(left)
        typer.echo(f"relmap: {done} of {len(cells)} cells were finished before", err=True)
    with _progress(len(left)) as advance:
        try:
            for cell, finished in run_cells(left, workers, scheduler) if left else ():
                store.save(cell, finished)
                found[cell] = finished
                advance()
        except KeyboardInterrupt:
            typer.echo(
                f"relmap: {len(found)} of {len(cells)} cells are finished; "
                "the same command goes on with the others",
                err=True,
            )
            raise
    rows = [found[cell] for cell in cells]
    atomic_write(out / "sweep.csv", accuracy_csv(cells, rows))
    atomic_write(out / "timing.csv", times_csv(cells, rows))
    try:
        write_parquet(out / "sweep.parquet", cells, rows)
    except RelmapError as error:
        typer.echo(f"relmap: {error}", err=True)
    return rows


def _lines(total: int) -> Callable[[], None]:
    """Return what counts cells and says so on stderr now and then."""
    began = told = monotonic()
    done = 0

    def advance() -> None:
        nonlocal told, done
        done, now = done + 1, monotonic()
        if now - told < EVERY_S:
            return
        told = now
        left_s = (now - began) / done * (total - done)
        said = f"{done} of {total} cells, about {_duration(left_s)} left"
        typer.echo(f"relmap: {said}", err=True)

    return advance


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


@contextmanager
def _progress(total: int) -> Iterator[Callable[[], None]]:
    """Show how many cells are done and how long the others will take, on stderr.

    Yields
    ------
    callable
        Counts one more cell.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(total)
        return
    columns = (BarColumn(), MofNCompleteColumn(), "cells,", TimeRemainingColumn(), "left")
    with Progress(*columns, console=console, speed_estimate_period=600) as shown:
        task = shown.add_task("", total=total)
        yield lambda: shown.advance(task)


def _print_medians(cells: Sequence[Cell], finished: Sequence[Finished]) -> None:
    """Print the medians over the seeds, one row for each combination of the rest."""
    import numpy as np

    from relmap.cli.plaintable import print_plain, shown
    from relmap.comparison.sweep_spec import varying

    keys = [key for key in varying(list(cells)) if key != "method"]
    rows: dict[tuple[str, ...], list[Finished]] = {}
    for cell, done in zip(cells, finished, strict=True):
        name = (cell.method, *(f"{getattr(cell, key)}" for key in keys))
        rows.setdefault(name, []).append(done)
    of_map = "corner_rmse_m" if cells[0].world == "building" else "landmark_rmse_m"
    figures = {"RMSE": of_map, "of": "matched", "cover": "coverage", "ATE": "ate_m", "RPE": "rpe_m"}
    figures |= {"ms": "median_ms", "mean": "mean_ms"}
    table = []
    for name, group in sorted(rows.items(), key=lambda row: (row[0][1:], row[0][0])):
        cells_ = []
        for heading, key in figures.items():
            values = [v for done in group if (v := done.figures[key]) is not None]
            cells_.append(shown(heading, float(np.median(values)) if values else None))
        table.append([*name, *cells_, str(len(group))])
    print_plain("medians over the seeds", ["method", *keys, *figures, "seeds"], table)
