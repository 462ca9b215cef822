"""Many methods on the same data, each in its own process."""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection

import numpy as np

from relmap.comparison.methods.registry import (
    MethodInfo,
    check_method,
    find_method,
    fitting_methods,
)
from relmap.comparison.methods.running import ACCURACY, COST, PATH, MethodRun, try_method
from relmap.core.arrays import Floats, Ints, positions_of
from relmap.core.errors import RelmapError
from relmap.datasets.base import ObservationLog
from relmap.evaluation import metrics
from relmap.evaluation.feeding import Association, Log, Method
from relmap.evaluation.sources import Data, Source
from relmap.evaluation.truth import Truth

FIGURES = (*ACCURACY, *PATH, *COST)
CSV_COLUMNS = ("method", "association", *FIGURES, "note")


@dataclass(frozen=True, eq=False)
class Compared:
    """The outcome of one method: its run, or None and the reason in `note`."""

    method: str
    run: MethodRun | None
    note: str = ""

    def row(self, association: Association) -> list[object]:
        """Return the cells of `CSV_COLUMNS`; None where a figure is not available."""
        figures = self.run.figures if self.run else {}
        return [self.method, association, *map(figures.get, FIGURES), self.note.replace(",", ";")]


def chosen_methods(
    names: Sequence[str] | None, data: Data[Log], association: Association
) -> list[MethodInfo]:
    """Return the named methods, or all that fit; RelmapError if one is unknown or does not fit."""
    if association == "known" and data.ids is None:
        if data.kind != "landmarks":
            raise RelmapError("--association known is for landmarks: point scans have no ids")
        raise RelmapError("--association known needs a log with ids, and this one has none")
    if names is None:
        return fitting_methods(data.kind, association)
    methods = [find_method(name) for name in names]
    for method in methods:
        if methods.count(method) > 1:
            raise RelmapError(f"method {method.name} is named twice")
        check_method(method, data.kind, association)
    return methods


def compare(
    source: Source,
    methods: Sequence[MethodInfo],
    association: Association,
    sigma_m: float | None = None,
) -> Iterator[Compared]:
    """Run methods one after the other, each in a fresh process.

    `source`: loaded in each process. `sigma_m`: noise passed to the methods, metres; estimated from
    the data if not given. The outcomes come in the order of the methods. If one fails, its note
    gives the reason.
    """
    for method in methods:
        if method.missing:
            yield Compared(method.name, None, f"not run: {method.missing}")
        else:
            yield in_own_process(method.name, source, association, sigma_m)


def in_own_process(
    name: str, source: Source, association: Association, sigma_m: float | None
) -> Compared:
    """Run one method in a fresh process; if it fails, the note gives the reason."""
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(
        target=_run_and_send, args=(sender, name, source, association, sigma_m), daemon=True
    )
    with interrupts_blocked():
        child.start()
    sender.close()
    try:
        outcome: Compared = receiver.recv()
    except EOFError:
        child.join()
        outcome = Compared(name, None, f"failed: its process ended with code {child.exitcode}")
    except KeyboardInterrupt:
        child.terminate()
        raise
    finally:
        child.join()
    return outcome


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Start processes that block Ctrl-C, which a terminal sends to all: the parent ends them.

    The parent gets a Ctrl-C of meanwhile afterwards.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # Its start, which comes with the first process, would unblock the signal.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _run_and_send(
    sender: Connection, name: str, source: Source, association: Association, sigma_m: float | None
) -> None:
    logging.basicConfig(format=f"relmap: {name}: %(message)s")
    sender.send(Compared(name, *try_method(name, source, association, sigma_m)))


def landmark_error_curve(
    method: Method, log: ObservationLog, truth: Truth, every: int
) -> tuple[Ints, Floats]:
    """Return the landmark error over the iterations of a log with known ids (Fig. 16).

    `method`: a new instance; `log`: with the true ids; `every`: iterations between points of the
    curve. Returns `iteration` (p,); `rmse_m` (p,): error of the static landmarks mapped so far,
    after rigid alignment; NaN with fewer than three.
    """
    static = truth.status == "static"
    ids, places = truth.landmark_ids[static], truth.landmarks_map[static]
    iterations, errors = [], []
    for number, scan in enumerate(log.scans(), 1):
        method.update(scan.points_robot, scan.ids)
        if number % every and number < len(log):
            continue
        found = method.map
        at = positions_of(ids, found.landmark_ids)
        known = at >= 0
        rmse = metrics.aligned_rmse(found.positions[known], places[at[known]])
        iterations.append(scan.iteration)
        errors.append(np.nan if rmse is None or known.sum() < 3 else rmse)
    return np.array(iterations, np.int64), np.array(errors, np.float64)
