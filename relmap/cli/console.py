"""What the verbs share to talk to a person: progress and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Annotated, TypeVar

import typer

T = TypeVar("T")

INTERRUPTED = 130
"""What the process exits with where Ctrl-C ended it."""
PATIENCE_S = 1.0
"""Work that is done sooner shows no progress."""


def folder(text: str) -> Path:
    """Return the folder that an option names.

    Raises
    ------
    typer.BadParameter
        Where it is empty, as an unset variable of a shell makes it.
    """
    if not text:
        raise typer.BadParameter("it is empty, expected the name of a folder")
    return Path(text)


Out = Annotated[
    Path, typer.Option("--out", "-o", metavar="DIR", parser=folder, help="Folder to write to.")
]
"""The option that names the folder to write to."""


def tracked(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Yield the items; show on stderr how far it is, where that is a terminal and it takes long."""
    began = monotonic()
    source = iter(items)
    done = 0
    for item in source:
        yield item
        done += 1
        if monotonic() - began > PATIENCE_S:
            break
    yield from _with_bar(source, done, total, what)


def _with_bar(source: Iterator[T], done: int, total: int, what: str) -> Iterator[T]:
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=total, completed=done)
        for item in source:
            yield item
            progress.advance(task)


@contextmanager
def busy(what: str) -> Iterator[Callable[[str], None]]:
    """Tell on stderr what is being done, where that is a terminal and it takes long.

    Yields
    ------
    callable
        Takes what is being done now.
    """
    from rich.console import Console

    status = Console(stderr=True).status(what)
    timer = Timer(PATIENCE_S, status.start)
    if status.console.is_terminal:
        timer.start()
    try:
        yield status.update
    finally:
        timer.cancel()
        if timer.ident is not None:
            timer.join()
        status.stop()


def print_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on stdout, its first column to the left and the others to the right."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD)
    for number, name in enumerate(header):
        table.add_column(name, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False, emoji=False)
    console.print(title, soft_wrap=True)
    console.print(table)
