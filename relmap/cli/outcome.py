"""Run a job, and say what became of it, early or not."""

from __future__ import annotations

from time import monotonic
from typing import Any

import typer

from relmap.cli.console import INTERRUPTED, lasting
from relmap.cli.job import Job
from relmap.cli.mapping import map_log

WHOLE = 0.9
"""Share of the scans in the largest submap of a run that did not break."""


def report(job: Job) -> None:
    """Map a log, and tell what came out.

    Raises
    ------
    typer.Exit
        Where the run was interrupted.
    """
    began = monotonic()
    run, n_files = map_log(job)
    took = f", {lasting(monotonic() - began)} in all"
    summary = run.result.summary
    counts, timing = summary["counts"], summary["timing"]
    iterations = counts["iterations"]
    begun = f"stopped after {iterations} of {summary['input_iterations']}: "
    told = f"{begun if summary['interrupted'] else ''}wrote {n_files} files to {job.out}: "
    hanging = on_odometry(summary.get("odometry"))
    if job.variant == "planes":
        told += (
            f"{counts['planes_static']} walls with {counts['corners_static']} corners mapped in "
            f"{iterations} iterations, {each(timing['scan_median_ms'])}{took}{hanging}"
            f"{torn(summary)}"
        )
    else:
        told += (
            f"{counts['mapped']} of {counts['landmarks']} landmarks mapped from "
            f"{counts['observations']} observations in {iterations} iterations, "
            f"{each(timing['median_ms'])}{took}{untied(len(run.result.submaps) - 1)}"
            f"{doubted(summary['association_trust'])}{hanging}"
            f"{unconverged(summary['refinement'])}"
        )
    typer.echo(told)
    if job.onto and job.association == "nearest" and summary["tied_at"] is None:
        typer.echo(f"no scan was found in the map of {job.onto}: the log is a submap of its own")
    if summary["interrupted"]:
        if job.journal is not None:
            typer.echo(f"'relmap resume {job.journal}' goes on with it")
        raise typer.Exit(INTERRUPTED)


def each(median_ms: float | None) -> str:
    """Return how long an iteration took, as part of a message."""
    if median_ms is None:
        return "none of them new"
    value, unit = (median_ms / 1e3, "s") if median_ms >= 1e3 else (median_ms, "ms")
    digits = 2 if value < 1 else 1 if value < 10 else 0
    return f"median {value:.{digits}f} {unit} each"


def torn(summary: dict[str, Any]) -> str:
    """Return into which submaps a run of walls broke, and its weak links: the end of a message."""
    submaps = summary["submaps"]
    failed = sum(not submap["refined"] for submap in submaps) if summary["refined"] else 0
    told = ""
    if len(submaps) > 1:
        scans, metres = submaps[0]["scans"], submaps[0]["metres"]
        told += (
            f"; the run broke into {len(submaps)} submaps: the largest, of {scans} "
            f"scans and {metres:.1f} m, is the map"
        )
    if failed:
        told += f"; {failed} of {len(submaps)} submaps could not be refined"
    if weak := len(summary["weak_links"]):
        told += f"; links whose length nothing measured, so that the motion was continued: {weak}"
    return told + _advice(summary)


def _advice(summary: dict[str, Any]) -> str:
    """Return what may hold a run together that fell to pieces, as the end of a message."""
    scans = [submap["scans"] for submap in summary["submaps"]]
    steps = summary["steps"]
    if len(scans) < 2 or scans[0] >= WHOLE * sum(scans) or steps["median_m"] is None:
        return ""
    view_deg = steps["view_deg"]
    view = "" if view_deg is None else f" (here {view_deg:.0f} degrees)"
    return (
        f". More overlap between scans helps: shorter steps (here "
        f"{steps['median_m']:.2f} m and {steps['median_deg']:.0f} degrees in the median) or a "
        f"wider view{view}; odometry, where there is any, bridges breaks"
    )


def doubted(trust: dict[str, Any]) -> str:
    """Return how far association is to be trusted, as the end of a message."""
    tied, unique, undone = (trust[key] for key in ("tied_scans", "unique_scans", "undone_merges"))
    told = ""
    if tied is not None and min(tied, unique) < 1:
        told += (
            f"; {100 * tied:.1f} % of the scans were tied to those before, {100 * unique:.1f} % "
            f"by more matches than chance explains"
        )
    return told + (f"; {undone} merge{'s' if undone > 1 else ''} undone" if undone else "")


def on_odometry(odometry: dict[str, Any] | None) -> str:
    """Return what rests on odometry alone, or that it is wrong, as the end of a message."""
    if odometry is None:
        return ""
    if odometry["wrong_throughout"]:
        return "; odometry contradicts what was seen and was left out"
    alone, left_out = (odometry[key]["count"] for key in ("tied_by_it_alone", "left_out"))
    told = f"; {alone} scans are tied by odometry alone, as good as it is" if alone else ""
    return told + (f"; odometry was left out at {left_out} scans" if left_out else "")


def untied(submaps: int) -> str:
    """Return how many submaps of a map are apart, as the end of a message."""
    if submaps < 1:
        return ""
    return f"; {submaps} submap{'s' if submaps > 1 else ''} could not be tied to the map"


def unconverged(refinement: dict[str, Any] | None) -> str:
    """Return that a refinement did not converge, as a line after a message."""
    if refinement is None or refinement["converged"]:
        return ""
    return (
        "\nWARNING: the refinement did not converge, so the map is the best one found and may be "
        "wrong; look for wrong ids or matches, or compare with --no-refine"
    )
