"""``relmap resume``: continue a run that ended early."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from relmap.cli.arguments import folder
from relmap.cli.interrupt import stoppable

HELP = """Continue a run of 'relmap map --journal FILE' that ended early.

The content of the journal is mapped again, and the rest is read from the original log.  The map is
the same, to the last bit, as without the interruption.

\b
Examples:
  relmap map eight/observations.csv -o result --journal run.journal
  relmap resume run.journal
"""


def command(
    journal: Annotated[Path, typer.Argument(metavar="FILE", help="The journal.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            parser=folder,
            help="Folder to write to; that of the run if not given.",
        ),
    ] = None,
    repair: Annotated[
        bool,
        typer.Option(
            "--salvage",
            help="Recover the undamaged beginning of a journal, and continue from there. "
            "The damaged file is kept as FILE.damaged.",
        ),
    ] = False,
) -> None:
    """Resume a run; the help text explains the arguments."""
    from relmap.cli.job import Job
    from relmap.cli.outcome import report
    from relmap.io.journal import JournalReader, salvage

    if repair:
        typer.echo(f"recovered {salvage(journal)} scans of {journal}")
    with JournalReader(journal) as reader:
        job = Job.of_journal(journal, reader.meta)
    if out is not None:
        job = replace(job, out=out.absolute())
    with stoppable() as stopped:
        report(replace(job, stopped=stopped))
