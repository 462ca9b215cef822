"""Progress and tables of all verbs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from heapq import nlargest
from threading import Event, Thread
from time import monotonic
from typing import TYPE_CHECKING, TypeVar

import typer

if TYPE_CHECKING:
    from rich.progress import Progress

T = TypeVar("T")

INTERRUPTED = 130
"""Exit status after Ctrl-C."""
PATIENCE_S = 1.0
"""Work shorter than this shows no progress."""
EVERY_S = 10.0
"""Seconds between two lines of progress if not on a terminal."""
STEADY_S = 600.0
"""Time over which the speed is averaged to estimate the remaining time."""
COMPILING = 10
"""Largest number of steps left out of the estimate of the remaining time: they may compile."""
WIDEST = 1000
"""Maximum width of a table: it is as wide as needed, independent of the terminal."""


class Counter:
    """Shows progress on stderr if work takes long: a bar on a terminal, else lines.

    It is a callback for `relmap.map_log`: called with the work done and the total.

    `patience_s`: shorter work shows no progress; `PATIENCE_S` if not given.
    """

    def __init__(self, what: str, patience_s: float | None = None) -> None:
        self._what = what
        self._patience_s = PATIENCE_S if patience_s is None else patience_s
        self._began = self._printed = self._latest = monotonic()
        self._slowest_s: list[float] = []
        self._before: int | None = None
        self._bar: Progress | None = None
        self._is_terminal: bool | None = None

    def __call__(self, done: int, total: int) -> None:
        """Show progress."""
        now = monotonic()
        self._slowest_s = nlargest(COMPILING, [*self._slowest_s, now - self._latest])
        self._latest = now
        if self._before is None:
            self._before = done - 1
        if now - self._began <= self._patience_s:
            return
        if self._is_terminal is None:
            self._begin(total)
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=done)
        elif not self._is_terminal and now - self._printed >= EVERY_S and done < total:
            line = f"relmap: {self._what}: {done} of {total}"
            typer.echo(line + self._left(now, done - self._before, total - self._before), err=True)
            self._printed = now

    def _left(self, now: float, done: int, total: int) -> str:
        """Return the estimated remaining time, without the slowest steps: they may compile."""
        if done < max(2, total / 100):
            return ""
        slowest_s = self._slowest_s[: max(1, min(done // 2, total // 20))]
        step_s = (now - self._began - sum(slowest_s)) / (done - len(slowest_s))
        return f", about {lasting(step_s * (total - done))} left"

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _begin(self, total: int) -> None:
        """Start a bar if stderr is a terminal."""
        from rich.console import Console
        from rich.progress import Progress

        console = Console(stderr=True)
        self._is_terminal = console.is_terminal
        if self._is_terminal:
            self._bar = Progress(console=console, transient=True, speed_estimate_period=STEADY_S)
            self._bar.add_task(self._what, total=total)
            self._bar.start()


def tracked(
    items: Iterable[T], total: int, what: str, patience_s: float | None = None
) -> Iterator[T]:
    """Yield the `total` items; show progress on stderr if it takes long, see `Counter`."""
    with closing(Counter(what, patience_s)) as counter:
        for done, item in enumerate(items, 1):
            yield item
            counter(done, total)


def lasting(seconds: float) -> str:
    """Return a duration in readable form."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


@contextmanager
def busy(what: str) -> Iterator[Callable[[str], None]]:
    """Show the current activity on stderr if it takes long, as lines if not on a terminal.

    Yields a function that takes the current activity.
    """
    from rich.console import Console

    status = Console(stderr=True).status(what)
    is_terminal = status.console.is_terminal
    doing, over, began = [what], Event(), monotonic()

    def show() -> None:
        if is_terminal and not over.wait(PATIENCE_S):
            status.start()
        while not is_terminal and not over.wait(EVERY_S):
            line = f"relmap: {doing[-1]}, for {lasting(monotonic() - began)} so far"
            typer.echo(line, err=True)

    thread = Thread(target=show, daemon=True)
    thread.start()
    try:
        yield status.update if is_terminal else doing.append
    finally:
        over.set()
        thread.join()
        status.stop()


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
    """Return a figure in readable form: an error or ratio, or a "count", "share" or "time"."""
    if value is None:
        return "-"
    if kind == "count" or (kind == "time" and value >= 100):
        return f"{value:.0f}"
    if kind == "share":
        return f"{100 * value:.0f} %"
    return f"{value:.2g}" if kind == "time" else f"{value:.4f}"


def counted(n: int, what: str = "scan") -> str:
    """Return a number of scans, or others, as part of a message."""
    return f"{n} {what}{'' if n == 1 else 's'}"
