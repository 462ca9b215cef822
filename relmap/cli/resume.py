"""``relmap resume``: go on with a run that was ended before its time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from relmap.cli.console import folder
from relmap.cli.interrupt import stoppable
from relmap.cli.job import Job, Variant
from relmap.cli.outcome import report

HELP = """Go on with a run of 'relmap map --journal FILE' that was ended before its time.

What the journal holds is mapped again, the rest comes from the log that the run was begun with, and
the map is the same, to the last bit, as if nothing had happened.

\b
Examples:
  relmap map eight/observations.csv -o result --journal run.journal
  relmap resume run.journal
"""


def resume_command(
    journal: Annotated[Path, typer.Argument(metavar="FILE", help="The journal.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            parser=folder,
            help="Folder to write to; the one of the run where left out.",
        ),
    ] = None,
    repair: Annotated[
        bool,
        typer.Option(
            "--salvage",
            help="Of a damaged journal recover all before the damage, and go on from there. "
            "The damaged file is kept as FILE.damaged.",
        ),
    ] = False,
) -> None:
    """Resume a run; the arguments are explained in the help text."""
    from relmap.io.journal import JournalReader, salvage

    if repair:
        typer.echo(f"recovered {salvage(journal)} scans of {journal}")
    with JournalReader(journal) as reader:
        variant: Variant = "planes" if reader.layout.variant == "planes" else "points"
        job = Job.of_journal(journal, reader.meta, variant)
    if out is not None:
        job = replace(job, out=out.absolute())
    with stoppable() as stopped:
        report(replace(job, stopped=stopped))
