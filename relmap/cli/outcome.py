"""What is said of a run that has ended, early or not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from relmap.cli.console import INTERRUPTED

if TYPE_CHECKING:
    from relmap.cli.job import Job


def stopped_after(summary: dict[str, Any]) -> str:
    """Return how far an interrupted run came, as the beginning of a message."""
    if not summary["interrupted"]:
        return ""
    return f"stopped after {summary['counts']['iterations']} of {summary['input_iterations']}: "


def each(median_ms: float | None) -> str:
    """Return how long an iteration took, as part of a message."""
    return "none of them new" if median_ms is None else f"median {readable(median_ms)} each"


def readable(ms: float) -> str:
    """Return a time as a person reads it."""
    value, unit = (ms / 1e3, "s") if ms >= 1e3 else (ms, "ms")
    digits = 2 if value < 1 else 1 if value < 10 else 0
    return f"{value:.{digits}f} {unit}"


def torn(summary: dict[str, Any]) -> str:
    """Return into which submaps a run of walls broke, as the end of a message."""
    submaps = summary["submaps"]
    failed = sum(not submap["refined"] for submap in submaps) if summary["refined"] else 0
    told = ""
    if len(submaps) > 1:
        scans, metres = submaps[0]["scans"], submaps[0]["metres"]
        told += (
            f"; the run broke into {len(submaps)} submaps that nothing ties to one another: the "
            f"largest, of {scans} scans and {metres:.1f} m, is the map"
        )
    if failed:
        told += f"; {failed} of {len(submaps)} submaps could not be refined"
    return told


def untied(pieces: int) -> str:
    """Return how many pieces of a map are apart, as the end of a message."""
    if pieces < 1:
        return ""
    return f"; {pieces} piece{'s' if pieces > 1 else ''} could not be tied to the map"


def unconverged(refinement: dict[str, Any] | None) -> str:
    """Return that a refinement did not converge, as a line after a message."""
    if refinement is None or refinement["converged"]:
        return ""
    return (
        "\nWARNING: the refinement did not converge, so the map is the best that was found and may "
        "be wrong; look for wrong ids or matches, or compare with --no-refine"
    )


def leave(job: Job, summary: dict[str, Any]) -> None:
    """End the program as what became of the run demands.

    Raises
    ------
    typer.Exit
        Where the run was interrupted.
    """
    if summary["interrupted"]:
        if job.journal is not None:
            typer.echo(f"'relmap resume {job.journal}' goes on with it")
        raise typer.Exit(INTERRUPTED)
