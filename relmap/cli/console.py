"""Progress and tables of all verbs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Thread, Timer
from time import monotonic
from typing import TypeVar

import typer

T = TypeVar("T")

INTERRUPTED = 130
"""Exit status after Ctrl-C."""
PATIENCE_S = 1.0
"""Work shorter than this shows no progress."""
EVERY_S = 10.0
"""Seconds between two lines of progress if not on a terminal."""
STEADY_S = 600.0
"""Time over which the speed is averaged to estimate the remaining time."""
WIDEST = 1000
"""Maximum width of a table: it is as wide as needed, independent of the terminal."""


def tracked(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Yield the items; show progress on stderr if it takes long, see `with_bar`."""
    began = monotonic()
    source = iter(items)
    done = 0
    for item in source:
        yield item
        done += 1
        if monotonic() - began > PATIENCE_S:
            break
    yield from with_bar(source, total, what, done, began)


def with_bar(
    items: Iterable[T], total: int, what: str, done: int = 0, began: float | None = None
) -> Iterator[T]:
    """Yield the items; show progress on stderr, as lines if it is not a terminal.

    Parameters
    ----------
    items : iterable
        The remaining items.
    total : int
    what : str
    done : int
        Number of items already done.
    began : float, optional
        Start time, by `time.monotonic`; now if not given.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    if not console.is_terminal:
        yield from _reported(items, total, what, done, monotonic() if began is None else began)
        return
    with Progress(console=console, transient=True, speed_estimate_period=STEADY_S) as progress:
        task = progress.add_task(what, total=total, completed=done)
        for item in items:
            yield item
            progress.advance(task)


def _reported(items: Iterable[T], total: int, what: str, done: int, began: float) -> Iterator[T]:
    """Yield the items; print a line on stderr at intervals."""
    told = began
    for number, item in enumerate(items, done + 1):
        yield item
        now = monotonic()
        if now - told >= EVERY_S and number < total:
            told, left_s = now, (now - began) / number * (total - number)
            line = f"relmap: {what}: {number} of {total}, about {lasting(left_s)} left"
            typer.echo(line, err=True)


def lasting(seconds: float) -> str:
    """Return a duration in readable form."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


@contextmanager
def busy(what: str) -> Iterator[Callable[[str], None]]:
    """Show the current activity on stderr if it takes long, as lines if not on a terminal.

    Yields
    ------
    callable
        Takes the current activity.
    """
    from rich.console import Console

    status = Console(stderr=True).status(what)
    if not status.console.is_terminal:
        with _told_by_lines(what) as now:
            yield now
        return
    timer = Timer(PATIENCE_S, status.start)
    timer.start()
    try:
        yield status.update
    finally:
        timer.cancel()
        timer.join()
        status.stop()


@contextmanager
def _told_by_lines(what: str) -> Iterator[Callable[[str], None]]:
    """Print the current activity and its duration on stderr at intervals."""
    doing, over, began = [what], Event(), monotonic()

    def tell() -> None:
        while not over.wait(EVERY_S):
            line = f"relmap: {doing[-1]}, for {lasting(monotonic() - began)} so far"
            typer.echo(line, err=True)

    teller = Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield doing.append
    finally:
        over.set()
        teller.join()


def print_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on stdout, first column left-aligned, the others right-aligned."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for number, name in enumerate(header):
        table.add_column(name, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False, emoji=False, width=WIDEST)
    console.print(title, soft_wrap=True)
    console.print(table)


def figure(value: float | None, kind: str = "") -> str:
    """Return a figure in readable form.

    Parameters
    ----------
    value : float or None
    kind : "count", "share" or "time", optional
        Kind of figure, if not an error or ratio.
    """
    if value is None:
        return "-"
    if kind == "count" or (kind == "time" and value >= 100):
        return f"{value:.0f}"
    if kind == "share":
        return f"{100 * value:.0f} %"
    return f"{value:.2g}" if kind == "time" else f"{value:.4f}"
