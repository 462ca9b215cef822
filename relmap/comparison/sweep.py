"""A grid of experiments, on all cores or a cluster; finished cells are not run again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Any, cast

from relmap import __version__
from relmap.comparison.methods.registry import find_method
from relmap.comparison.methods.running import ACCURACY, COST, try_method
from relmap.comparison.sweep_spec import KEYS, Cell
from relmap.core.errors import RelmapError
from relmap.io.files import atomic_write
from relmap.io.tables import csv_text

CELLS = "cells"
"""Folder of the finished cells, one file each."""
TIMES = tuple(name for name in COST if name != "memory_mb")
"""Figures that differ from run to run; a worker's memory is not that of one method."""
PATIENCE_S = 10
"""Timeout for connecting to a scheduler."""


@dataclass(frozen=True)
class Finished:
    """Result of a cell.

    `figures`: `ACCURACY` and `TIMES`, None if one is not available. `note`: reason if there are
    none; empty on success. `again`: whether to try again: an extra was missing.
    """

    figures: dict[str, float | None]
    note: str = ""
    again: bool = False


def run_cell(cell: Cell) -> tuple[Cell, Finished]:
    """Simulate the world of a cell and run its method; if it fails, the note gives the reason."""
    none: dict[str, float | None] = dict.fromkeys((*ACCURACY, *TIMES))
    missing = find_method(cell.method).missing
    if missing:
        return cell, Finished(none, f"not run: {missing}", again=True)
    run, note = try_method(cell.method, cell.source(), cell.association, cell.sigma or None)
    return cell, Finished({name: run.figures[name] for name in none} if run else none, note)


class CellStore:
    """The finished cells of a sweep, one small file each; RelmapError if no folder can be made."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / CELLS
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RelmapError(f"cannot write into {folder}: {error.strerror}") from error

    def load(self, cell: Cell) -> Finished | None:
        """Return a finished cell; None if it is missing, damaged or of another version."""
        try:
            record = json.loads(self._path(cell).read_text())
            figures, note = record["figures"], record["note"]
            whole = record == _record(cell, figures, note)
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            return None
        return Finished(figures, note) if whole else None

    def save(self, cell: Cell, finished: Finished) -> None:
        """Store a finished cell; RelmapError if it cannot be written."""
        if finished.again:
            return
        atomic_write(self._path(cell), json.dumps(_record(cell, finished.figures, finished.note)))

    def _path(self, cell: Cell) -> Path:
        text = json.dumps(asdict(cell), sort_keys=True)
        return self._folder / f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.json"


def _record(cell: Cell, figures: Any, note: Any) -> dict[str, Any]:
    """Return the content of the file of a cell, with a checksum."""
    record = {"version": __version__, "cell": asdict(cell), "figures": figures, "note": note}
    text = json.dumps(record, sort_keys=True)
    return record | {"checksum": hashlib.sha256(text.encode()).hexdigest()}


def run_cells(
    cells: Sequence[Cell], workers: int, scheduler: str | None = None
) -> Iterator[tuple[Cell, Finished]]:
    """Run cells and yield each as soon as it is finished.

    `workers`: processes on this machine; -1: one per core. `scheduler`: address of a dask
    scheduler, whose workers are used instead. Raises `RelmapError` if the scheduler cannot be
    reached, or a process is killed.
    """
    from joblib import Parallel, delayed

    jobs = (delayed(run_cell)(cell) for cell in cells)
    with _cluster(scheduler) if scheduler else nullcontext():
        settings = {} if scheduler else {"n_jobs": workers}
        parallel = Parallel(return_as="generator_unordered", batch_size=1, **settings)
        try:
            yield from parallel(jobs)
        except BrokenExecutor as error:
            raise RelmapError(
                "a worker process of the sweep was killed, perhaps because memory ran out: "
                "the same command continues, with --workers 1 in less memory"
            ) from error


def _cluster(scheduler: str) -> AbstractContextManager[Any]:
    """Return joblib's dask backend; RelmapError without dask, or if no scheduler answers."""
    try:
        from distributed import Client
    except ImportError as error:
        raise RelmapError(
            "--dask needs dask, which is not installed: pip install 'relmap[cluster]'"
        ) from error
    from joblib import parallel_config

    try:
        client = Client(scheduler, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise RelmapError(f"no dask scheduler answers at {scheduler}") from error
    return cast(
        AbstractContextManager[Any],
        parallel_config("dask", client=client, wait_for_workers_timeout=PATIENCE_S),
    )


def accuracy_csv(cells: Sequence[Cell], finished: Sequence[Finished]) -> str:
    """Return one row per cell: its parameters, and the reproducible figures."""
    return csv_text((*KEYS, *ACCURACY, "note"), _rows(cells, finished, ACCURACY, notes=True))


def times_csv(cells: Sequence[Cell], finished: Sequence[Finished]) -> str:
    """Return one row per cell: its parameters, and the times."""
    return csv_text((*KEYS, *TIMES), _rows(cells, finished, TIMES, notes=False))


def _rows(
    cells: Sequence[Cell], finished: Sequence[Finished], names: Sequence[str], notes: bool
) -> Iterator[list[object]]:
    for cell, done in zip(cells, finished, strict=True):
        figures, note = map(done.figures.__getitem__, names), done.note.replace(",", ";")
        yield [*astuple(cell), *figures, *([note] * notes)]


def write_parquet(path: Path, cells: Sequence[Cell], finished: Sequence[Finished]) -> None:
    """Write the table of `accuracy_csv` as Parquet; RelmapError if pyarrow is not installed."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise RelmapError(
            f"no {path.name}: pyarrow is not installed: pip install 'relmap[parquet]'"
        ) from error
    columns: dict[str, Any] = {key: [getattr(cell, key) for cell in cells] for key in KEYS}
    for name in ACCURACY:
        columns[name] = pa.array([done.figures[name] for done in finished], pa.float64())
    columns["note"] = [done.note for done in finished]
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns), sink)
    atomic_write(path, sink.getvalue().to_pybytes())
